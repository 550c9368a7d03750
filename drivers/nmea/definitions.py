"""Every field of each message of a ship's sensors that is read: read, or why not, and what in it means that nothing was measured.

A field that tells which sensor, frame or quality a value is of is as easily overlooked as a placeholder is taken for a value. A
message without rows is not read; a test compares the rows with the definitions of pynmea2, pyais, canboat and pyubx2, and with
what the readers read.
"""

from collections.abc import Mapping

from msgspec import Struct


class Read(Struct, frozen=True):
    """A field that is read."""

    absent: tuple[str, ...] = ("",)
    """Cells that mean "not measured"; of NMEA 2000, where that is a field's own highest value, nothing beside it."""
    instead: str = ""
    """The substitute for such a cell; empty where the sentence then gives no sample."""


Fields = Mapping[str, Read | str]

_R = Read()
_WHERE = dict.fromkeys(("lat", "lat_dir", "lon", "lon_dir"), _R)
_NO_MODE = ("N", "M", "S")
"""Modes of a place that was not measured: none, typed in, simulated."""
_REST = Read(instead="the other parts of the motion")
_TRUE = "the one from true north is read"
_UNITS = "the standard has one unit there"
_CORRECTIONS = "the quality of the fix has them in it"
_SATELLITES = "the dilution says what their number is worth"
_SEPARATION = "heights are of the ship and the drone by the same surface"
_WATER = "it is through the water"
_NAMED = "the sentence's name, which is read before"

SENTENCES: Mapping[str, Fields] = {
    "RMC": {
        "timestamp": _R, "status": Read(("", "V")), **_WHERE,
        "spd_over_grnd": Read(instead="the place alone"), "true_course": Read(instead="the place alone, unless she lies still"),
        "datestamp": "instants are known by the time of day", "mag_variation": _TRUE, "mag_var_dir": _TRUE,
        "mode_indicator": Read(_NO_MODE), "nav_status": Read(("U",)),
    },
    "GGA": {
        "timestamp": _R, **_WHERE, "gps_qual": Read(("", "0", "7", "8")), "num_sats": _SATELLITES,
        "horizontal_dil": Read(instead="a dilution of 2"), "altitude": Read(instead="a place without a height"),
        "altitude_units": _UNITS, "geo_sep": _SEPARATION, "geo_sep_units": _UNITS,
        "age_gps_data": _CORRECTIONS, "ref_station_id": _CORRECTIONS,
    },
    "GNS": {
        "timestamp": _R, **_WHERE, "mode_indicator": Read(("", "NN", "M", "AS")), "num_sats": _SATELLITES,
        "hdop": Read(instead="a dilution of 2"), "altitude": Read(instead="a place without a height"),
        "geo_sep": _SEPARATION, "age_gps_data": _CORRECTIONS, "diferential": _CORRECTIONS, "nav_status": Read(("U",)),
    },
    "GLL": {
        **_WHERE, "timestamp": Read(instead="the instant of its burst, or of its arrival"),
        "status": Read(("", "V")), "faa_mode": Read(_NO_MODE),
    },
    "VTG": {
        "true_track": _R, "true_track_sym": _UNITS, "mag_track": _TRUE, "mag_track_sym": _TRUE,
        "spd_over_grnd_kts": _R, "spd_over_grnd_kts_sym": _UNITS,
        "spd_over_grnd_kmph": "the same in other units", "spd_over_grnd_kmph_sym": _UNITS,
        "faa_mode": Read((*_NO_MODE, "E")),
    },
    "HDT": {"heading": _R, "hdg_true": Read(("", "M"))},
    "THS": {"heading": _R, "mode": Read(("M", "S", "V"))},
    "VHW": {
        "heading_true": _R, "true": Read(("M",)), "heading_magnetic": _TRUE, "magnetic": _TRUE,
        **dict.fromkeys(("water_speed_knots", "knots", "water_speed_km", "kilometers"), _WATER),
    },
    "ROT": {"rate_of_turn": _R, "status": Read(("V",))},
    "XDR": dict.fromkeys(("type", "value", "units", "id"), _R),
    "MWV": {"wind_angle": _R, "reference": _R, "wind_speed": _R, "wind_speed_units": _R, "status": Read(("V",))},
    "MWD": {
        "direction_true": _R, "true": _UNITS, "direction_magnetic": _TRUE, "magnetic": _TRUE,
        "wind_speed_knots": Read(instead="the one in m/s"), "knots": _UNITS,
        "wind_speed_meters": Read(instead="the one in knots"), "meters": _UNITS,
    },
    "PSXN,20": {
        "_blank": _NAMED, "message_type": _R, "horiz_qual": "places have a quality of their own",
        **dict.fromkeys(("hgt_qual", "head_qual", "rp_qual"), Read(("2",), "the parts of PSXN,23 that are good")),
    },
    "PSXN,22": {
        "_blank": _NAMED, "message_type": _R,
        **dict.fromkeys(("gyro_calib", "gyro_ffs"), "the quality of PSXN,20 has the state of the gyro in it"),
    },
    "PSXN,23": {"_blank": _NAMED, "message_type": _R, **dict.fromkeys(("roll", "pitch", "head", "heave"), _REST)},
    "PSXN,24": {
        "_blank": _NAMED, "message_type": _R, "yaw_rate": _R,
        **dict.fromkeys(("roll_rate", "pitch_rate", "vertical_vel"), "the motion itself is read"),
    },
    "PASHR": {
        "_r": _NAMED, "timestamp": _R, "is_true_heading": _REST,
        **dict.fromkeys(("true_heading", "roll", "pitch", "heave"), _REST),
        **dict.fromkeys(("roll_accuracy", "pitch_accuracy"), Read(instead="what the digits leave")),
        "heading_accuracy": "it has the worth of a compass's", "aiding_status": "roll, pitch and heave do without",
        "imu_status": Read(("0",)),
    },
    "PRDID": {"subtype": _NAMED, **dict.fromkeys(("pitch", "roll", "heading"), _REST)},
}  # fmt: skip
"""Sentences with the field names of pynmea2; TSS1 and EM3000 have fixed columns and are read whole."""
SENTENCE_KINDS = {name.partition(",")[0] for name in SENTENCES}

_SID = "what belongs to one instant comes together"
_TRAFFIC = "it is of the radio's traffic"
AIS: Fields = {
    "msg_type": _R, "mmsi": _R, "speed": Read(("102.3",)), "accuracy": _R, "lon": Read(("181",)), "lat": Read(("91",)),
    "course": Read(("360",)), "heading": Read(("511",)), "second": Read(("61", "63")),
    "turn": "most transponders have no gyro and reckon it", "status": "her place and way say what she does",
    **dict.fromkeys(("repeat", "cs", "display", "dsc", "band", "msg22", "assigned", "radio", "dte", "maneuver"), _TRAFFIC),
    **dict.fromkeys(("spare_1", "reserved_1", "reserved_2"), "nothing is in it"),
    "raim": "the accuracy is read", "epfd": "likewise",
    **dict.fromkeys(("shipname", "ship_type"), "her number names her"),
    **dict.fromkeys(("to_bow", "to_stern", "to_port", "to_starboard"), "the pad's place from the antenna is a setting"),
}  # fmt: skip
"""Fields of position reports, with the names of pyais."""

MESSAGES: Mapping[int, tuple[str, Fields]] = {
    127250: ("heading", {"sid": _SID, **dict.fromkeys(("heading", "deviation", "variation", "reference"), _R)}),
    127251: ("turn", {"sid": _SID, "rate": _R}),
    127252: ("heave", {"sid": _SID, "heave": _R}),
    127257: ("attitude", {"sid": _SID, "yaw": "headings are read of 127250", "pitch": _R, "roll": _R}),
    127258: (
        "variation",
        {
            "sid": _SID, "source": "one source is read, as of each quantity",
            "ageOfService": "a model of some years ago is right to a degree", "variation": _R,
        },
    ),
    129025: ("position", {"latitude": _R, "longitude": _R}),
    129026: ("course", {"sid": _SID, "cogReference": _R, "cog": _R, "sog": _R}),
    129029: (
        "gnss",
        {
            "sid": _SID, **dict.fromkeys(("date", "time"), "the wire's own times are those of all its messages"),
            **dict.fromkeys(("latitude", "longitude", "altitude", "method", "hdop"), _R),
            "gnssType": "the method says what a place is worth", "pdop": "the horizontal one is read",
            "integrity": "of most receivers it has no value, which the decoder reads as unsafe",
            "numberOfSvs": _SATELLITES, "geoidalSeparation": _SEPARATION,
            **dict.fromkeys(("referenceStations", "referenceStationType", "referenceStationId"), _CORRECTIONS),
            "ageOfDgnssCorrections": _CORRECTIONS,
        },
    ),
    130306: ("wind", {"sid": _SID, "windSpeed": _R, "windAngle": _R, "reference": _R}),
}  # fmt: skip
"""Messages of NMEA 2000 with the quantity of each, by canboat's names; reserved bits are left out.

Which device sent one is its NAME (`ship_bus.Devices`)."""

_FLAGS = ("gnssFixOK", "diffSoln", "relPosValid", "carrSoln", "isMoving")
_HIGH = "pyubx2 adds it to the part in centimetres"
RELPOSNED: Fields = {
    "version": "the length of the frame is read, which goes with it",
    **dict.fromkeys(("reserved0", "reserved1", "reserved2"), "nothing is in it"),
    "refStationID": "a receiver has one base at a time, and a wrong one is too far away or does not move",
    **dict.fromkeys(("iTOW", "relPosN", "relPosE", "relPosD", "accN", "accE", "accD"), _R),
    **dict.fromkeys(("_HPrelPosN", "_HPrelPosE", "_HPrelPosD", "_HPrelPosLength"), _HIGH),
    "relPosHeading": _R, "accHeading": _R,
    "relPosLength": "the vector has it", "accLength": "likewise",
    **dict.fromkeys(_FLAGS, Read(("0",))), "refPosMiss": Read(("1",)), "refObsMiss": Read(("1",), "a wider sigma"),
    "relPosHeadingValid": Read(("0",)), "relPosNormalized": Read(("1",)),
}  # fmt: skip
"""Fields of u-blox receivers, with the names of pyubx2."""
