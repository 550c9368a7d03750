"""Measure the time from a frame's arrival to its LANDING_TARGET: see `benches.cost`, whose service and vehicles it has."""

from functools import partial

from benches import cost

main = partial(cost.main, latency=True)

if __name__ == "__main__":
    main()
