"""Set landings with and without each of a ship's sensors side by side: see `benches.landings`, whose table and options it has."""

from benches.landings import SHIP_SENSORS, main

if __name__ == "__main__":
    main(SHIP_SENSORS, ("sea_state_4", "weather_4", "sea_state_6"))
