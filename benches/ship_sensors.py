"""Set landings with and without each of a ship's sensors side by side: see `benches.landings`, whose table and options it has."""

from functools import partial

from benches import landings

main = partial(landings.main, landings.SHIP_SENSORS, ("sea_state_4", "weather_4", "sea_state_6"))

if __name__ == "__main__":
    main()
