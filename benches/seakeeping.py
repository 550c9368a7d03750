"""Compute the motion of vessels in each sea state, heave, roll and pitch, from their responses, without a flight.

    python -m benches.seakeeping                       the table of docs/sea.md
    python -m benches.seakeeping --plot FILE           the spectrum of generated seas beside the formulae
    python -m benches.seakeeping --table VESSEL        a vessel's response as the table of a vessel's file

The root mean square is exact for the sea that is drawn: half the sum of squared amplitudes of response times wave, over seeds.
"""

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from companion.settings.load import SHIPPED, shipped
from estimator.contracts.geometry import F64
from sitl.sea.sea import SEA_STATES, SeaState, Waves
from sitl.vessel.file import Mode, Table, load
from sitl.vessel.seakeeping import MODES, Hull, encounter_rad_s, responses
from tests.support.vessel_table_text import as_toml

SEEDS = range(20)
HEADINGS = {"head": 180.0, "bow": 135.0, "beam": 90.0, "following": 0.0}
SPEED_M_S = 1.5


def hulls() -> dict[str, Hull]:
    """Return the shipped vessels, the shortest first."""
    found = {name: load(SHIPPED / "vessels" / f"{name}.toml").hull for name in shipped("vessels")}
    return dict(sorted(found.items(), key=lambda item: item[1].length_m))


def rms(hull: Hull, state: SeaState, beta_rad: float, speed_m_s: float) -> F64:
    """Return (6,) root mean squares of the motion, and of the pad's vertical velocity as a seventh, in m, rad, m/s."""
    waves = Waves.draw(state, SEEDS, towards_rad=beta_rad)
    h = responses(hull, waves.w_rad_s, waves.towards_rad, speed_m_s)
    x, y = hull.d_vessel_pad_m
    vertical = encounter_rad_s(waves.w_rad_s, waves.towards_rad, speed_m_s) * (h[2] - x * h[4] + y * h[3])
    each = np.concatenate([np.abs(h), np.abs(vertical)[None]])
    return np.asarray(np.sqrt(0.5 * ((each * waves.amplitude_m) ** 2).sum(axis=-1).mean(axis=-1)))


def report() -> None:
    """Print the table as Markdown."""
    out = sys.stdout
    out.write(f"{SPEED_M_S} m/s ahead, JONSWAP, spreading s = 10, {len(SEEDS)} seeds\n")
    out.write("root mean square of heave in m/roll in degrees/pitch in degrees/vertical speed of the pad in m/s\n\n")
    out.write("| vessel | sea state | " + " | ".join(f"{name} sea" for name in HEADINGS) + " |\n")
    out.write("|---|---|" + "---|" * len(HEADINGS) + "\n")
    for name, hull in hulls().items():
        for code in range(2, 7):
            cells = []
            for heading in HEADINGS.values():
                m = rms(hull, SEA_STATES[code], math.radians(heading), SPEED_M_S)
                cells.append(f"{m[2]:.2f}/{math.degrees(m[3]):.1f}/{math.degrees(m[4]):.1f}/{m[6]:.2f}")
            out.write(f"| {name} | {code} | " + " | ".join(cells) + " |\n")


def table_of(hull: Hull) -> Table:
    """Return a hull's response at rest as a table: every 10 degrees, forty frequencies around its length."""
    own = math.sqrt(math.tau * 9.80665 / hull.length_m)
    w, headings = own * np.geomspace(0.15, 4.0, 40), np.linspace(0.0, 180.0, 19)
    h = responses(hull, w, np.radians(headings)[:, None])
    modes = {}
    for i, mode in enumerate(MODES):
        z = h[i] * (-1.0 if mode == "heave" else 1.0) * (math.degrees(1.0) if i > 2 else 1.0)
        modes[mode] = Mode(tuple(map(tuple, np.abs(z).tolist())), tuple(map(tuple, np.degrees(-np.angle(z)).tolist())))
    return Table(tuple(w.tolist()), tuple(headings.tolist()), **modes)


def plot(path: Path) -> None:
    """Draw periodograms of generated surfaces over the formulae they were drawn from."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    swell, wind = SeaState.swell_and_wind_sea(1.88)
    cases = {
        "JONSWAP, sea state 4": (SEA_STATES[4],),
        "Pierson-Moskowitz, Hs 1.88 m": (SeaState.fully_grown(1.88),),
        "Ochi-Hubble, most probable for Hs 1.88 m": (swell, wind),
    }
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.8), sharey=True, constrained_layout=True)
    t = np.arange(0.0, 1800.0, 0.4)
    for axis, (title, systems) in zip(axes, cases.items(), strict=True):
        w = np.linspace(0.2, 2.5, 600)
        for components, colour in (("geometric", "tab:blue"), ("equal_energy", "tab:green")):
            waves = Waves.together(
                [Waves.draw(s, range(40), components=components, stream=i) for i, s in enumerate(systems)]  # type: ignore[arg-type]
            )
            eta = waves.elevation((0.0, 0.0), t)
            window = np.hanning(t.size)
            power = (np.abs(np.fft.rfft(eta * window, axis=1)) ** 2).mean(axis=0) * 2.0 * 0.4 / (math.tau * (window**2).sum())
            at = math.tau * np.fft.rfftfreq(t.size, 0.4)
            smooth = np.convolve(power, np.ones(7) / 7, "same")
            height = float(np.mean(4.0 * eta.std(axis=1)))
            axis.plot(at, smooth, color=colour, lw=1, label=f"{components}: Hs {height:.2f} m")
        axis.plot(w, sum(s.density(w) for s in systems), "k--", lw=1.2, label="formula")
        axis.set(title=title, xlabel="rad/s", xlim=(0.2, 2.5))
        axis.legend(frameon=False, fontsize=8)
    axes[0].set_ylabel("m² s")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Read the options and do what they request."""
    parser = argparse.ArgumentParser(description="How vessels move in each sea state.")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the spectra of generated seas")
    parser.add_argument("--table", metavar="VESSEL", help="print a shipped vessel's response as a table")
    args = parser.parse_args()
    if args.plot is not None:
        plot(args.plot)
    elif args.table is not None:
        found = hulls()
        if args.table not in found:
            parser.error(f"--table must be one of {', '.join(found)}, got {args.table!r}")
        sys.stdout.write(as_toml(table_of(found[args.table])))
    else:
        report()


if __name__ == "__main__":
    main()
