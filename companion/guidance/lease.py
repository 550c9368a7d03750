"""An ordered landing is a lease: every guidance cycle renews it, and it ends by time, height or sight."""

from __future__ import annotations

from dataclasses import dataclass, replace

from companion.guidance.plan import Plan
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs, seconds_between

NO_LANDING = "no landing was reported"
_RISEN_M = 0.4
_ASIDE_M = 0.3
_BELOW_DECK_M = 0.6
"""A drone on deck without sight may be estimated some decimetres away from it."""
_BLIND_MARGIN_M = 0.1


@dataclass(frozen=True, slots=True)
class Lease:
    """A landing under way."""

    since: MonoNs
    from_height_m: float
    seen: MonoNs
    """Time of the last estimate that was fit to steer by."""
    height_m: float
    """Height at that time."""

    @staticmethod
    def begin(now: MonoNs, estimate: RelativeState) -> Lease:
        """Begin a lease at the order to land."""
        return Lease(now, estimate.height_m, now, estimate.height_m)


def renewed(
    lease: Lease, plan: Plan, now: MonoNs, estimate: RelativeState | None, fit: RelativeState | None
) -> tuple[Lease, str | None]:
    """Renew the lease for one more guidance cycle, or say why it ends.

    Args:
        estimate: the newest estimate, propagated without sight if necessary.
        fit: the same estimate if it is fit to steer by, otherwise None.

    Returns:
        The lease, and why it ends; None while it goes on. From the height of the last way point down the pad leaves the camera's
        view, so there only the time ends the lease; higher up the loss of the pad ends it too.
    """
    final = plan.way_points[-1]
    if seconds_between(lease.since, now) > plan.guidance.land_timeout_s:
        return lease, f"{NO_LANDING} within {plan.guidance.land_timeout_s:g} s"
    if estimate is not None and estimate.height_m < -_BELOW_DECK_M:
        return lease, "it came down past the deck"
    if fit is not None:
        lease = replace(lease, seen=now, height_m=fit.height_m)
        if fit.height_m > lease.from_height_m + _RISEN_M:
            return lease, "it rose instead of landing"
        if fit.lateral_m > final.reached_m + _ASIDE_M + float(abs(final.d_body_pad_level[0])):
            return lease, "it drifted off the pad while landing"
        return lease, None
    blind_below_m = float(final.d_body_pad_level[2]) + final.reached_height_m + _BLIND_MARGIN_M
    if lease.height_m > blind_below_m and seconds_between(lease.seen, now) > plan.guidance.stale_after_s:
        return lease, f"the pad was lost at {lease.height_m:.1f} m while landing"
    return lease, None
