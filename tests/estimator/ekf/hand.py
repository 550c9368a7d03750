"""Beliefs made by hand, at any instant and with any numbers in them, for a single step whose outcome can be worked out."""

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, rpy_matrix
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import EkfOptions
from estimator.ekf.params import FilterParams
from estimator.ekf.state import CAMERA_DELAY, CAMERA_MOUNT, PAD_YAW, POS_REL, VEL, N
from tests.estimator.ekf.belief import Belief, DeckMotionBank, initial, unknown

OPTIONS = EkfOptions()
TOOLS = FilterParams(OPTIONS)
MS = 1_000_000
S = 1_000_000_000
T = 500 * S
LEVEL = np.eye(3)
TILTED = rpy_matrix(0.1, -0.15, 0.8)


def params(**changed: object) -> FilterParams:
    o = structs.replace(OPTIONS, **changed)  # type: ignore[arg-type]
    return FilterParams(o)


def stamp(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.0, "sim")


def correlated(seed: int = 1, size: float = 1.0) -> F64:
    """(N, N) covariance in which everything hangs together, of about the size of a filter's after a minute."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(N, N)) / np.sqrt(N) + np.eye(N)
    sigma = size * rng.uniform(0.005, 0.02, N)
    P = A @ A.T * sigma[:, None] * sigma
    return np.asarray(0.5 * (P + P.T))


def state(seed: int = 2) -> F64:
    """(N,) numbers, no two alike; the attitude's error is zero and the velocity's scale about one, as always."""
    x = np.random.default_rng(seed).uniform(-0.3, 0.3, N)
    x[:3] = 0.0
    x[3:6] = 0.7, -0.4, 2.5
    x[15] += 1.0
    return np.asarray(x)


def under(x: float = 0.0, y: float = 0.0, z: float = 2.0) -> F64:
    """(N,) a pad there, nothing else known to be anything but zero."""
    state = np.zeros(N)
    state[POS_REL], state[15] = (x, y, z), 1.0
    return state


def diagonal(**var: float) -> F64:
    """(N, N) variances: small everywhere but where said."""
    P = np.eye(N) * 1e-8
    places = {
        "d": POS_REL,
        "v": VEL,
        "head": slice(PAD_YAW, PAD_YAW + 1),
        "mount": CAMERA_MOUNT,
        "delay": slice(CAMERA_DELAY, CAMERA_DELAY + 1),
    }
    for name, value in var.items():
        P[places[name], places[name]] = np.eye(len(P[places[name]])) * value
    return P


def learned(*, t: int = T, heave_m_s: float = 0.0) -> DeckMotionBank:
    """Return a sea after a look just now, with this heave rate; the other directions move differently."""
    sigma, w = np.array([0.3, 0.4, 0.0, 0.02, 0.03]), np.array([0.7, 0.9, 0.8, 1.1, 1.2])
    sigma[2] = heave_m_s / w[2]
    return unknown()._replace(t=t, sigma=sigma, w_rad_s=w)


def belief(R: F64 = LEVEL, *, t: int = T, x: F64 | None = None, P: F64 | None = None, **fields: object) -> Belief:
    """Settled, sighted 20 ms ago, its heading known; nothing gathered, nothing refused, the sea looked at just now."""
    b = initial(OPTIONS, t, R, 0.05, 0.1, learned(t=t))
    b = b._replace(
        x=np.zeros(N) if x is None else x, P=correlated() if P is None else P, levelled_by=R, cov_levelled_by=np.zeros((3, 3)),
        heading_is_given=True, sighted=max(t - 20 * MS, 0), agreed=10, heading_known=True, heading_held_s=5.0, heading_seen=t,
    )  # fmt: skip
    return b._replace(**fields)  # type: ignore[arg-type]


def sighting(
    d: F64 | tuple[float, float, float], yaw: float | None = None, *, t: int = T, ambiguous: bool = False, var: float = 1e-4,
    yaw_var: float = 1e-3, confidence: float = 1.0, pose6: Pose6 | None = None,
) -> Sighting:  # fmt: skip
    cov = np.diag([var] * 3 + [yaw_var if yaw is not None else np.pi**2 / 3.0])
    return Sighting(stamp(t), 7, "selected", np.asarray(d, dtype=float), yaw, ambiguous, cov, confidence, pose6)


def whole(d: F64 | tuple[float, float, float], R_level_pad: F64, cov: F64 | None = None) -> Pose6:
    C = np.diag([1e-4] * 3 + [1e-3] * 3) if cov is None else cov
    return Pose6(np.asarray(d, dtype=float), Rotation(R_level_pad), C)


def imu(t: int, w: F64 | tuple[float, float, float], f: F64 | tuple[float, float, float]) -> Imu:
    return Imu(stamp(t), np.asarray(w, dtype=float), np.asarray(f, dtype=float))
