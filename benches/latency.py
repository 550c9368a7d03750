"""Measure the time from a frame's arrival to its LANDING_TARGET: see `benches.cost`, whose service and vehicles it has."""

from benches.cost import main

if __name__ == "__main__":
    main(latency=True)
