"""Navdata options 11 to 16, 19, 20 and 25: what the drone's own vision and video report.

Source: Parrot SDK 2.0.1 `navdata_common.h`, checked against a datagram of firmware 2.4.8.
"""

from typing import Annotated

from msgspec import Struct

from drivers.ardrone.navdata_layout import F32, I32, U8, U32, Floats, Ints, option

_ZERO4 = (0, 0, 0, 0)
_ZERO5F = (0.0,) * 5


@option(11)
class VisionRaw(Struct, frozen=True):
    """The translation between two frames that the flow sensor measured."""

    vision_t_raw: Annotated[Floats, "3f"] = (0.0, 0.0, 0.0)


@option(12)
class VisionOf(Struct, frozen=True):
    """Optical flow at five points."""

    of_dx: Annotated[Floats, "5f"] = _ZERO5F
    of_dy: Annotated[Floats, "5f"] = _ZERO5F


@option(13)
class Vision(Struct, frozen=True):
    """The state of the flow sensor, with the attitude at the frame that it used last."""

    vision_state: U32 = 0
    vision_misc: I32 = 0
    phi_trim: F32 = 0.0
    phi_ref_prop: F32 = 0.0
    theta_trim: F32 = 0.0
    theta_ref_prop: F32 = 0.0
    new_raw_picture: I32 = 0
    theta_capture_rad: F32 = 0.0
    phi_capture_rad: F32 = 0.0
    psi_capture_rad: F32 = 0.0
    altitude_capture_mm: I32 = 0
    time_capture_ms: U32 = 0
    """The capture time on the drone's clock; unlike `Time` it is plain milliseconds (in two captures 10 and 19 ms before it)."""
    body_v: Annotated[Floats, "3f"] = (0.0, 0.0, 0.0)
    """The body velocity, mm/s."""
    delta_phi: F32 = 0.0
    delta_theta: F32 = 0.0
    delta_psi: F32 = 0.0
    gold_defined: U32 = 0
    gold_reset: U32 = 0
    gold_x: F32 = 0.0
    gold_y: F32 = 0.0


@option(14)
class VisionPerf(Struct, frozen=True):
    """The times that the vision stages took."""

    time_szo: F32 = 0.0
    time_corners: F32 = 0.0
    time_compute: F32 = 0.0
    time_tracking: F32 = 0.0
    time_trans: F32 = 0.0
    time_update: F32 = 0.0
    time_custom: Annotated[Floats, "20f"] = (0.0,) * 20


@option(15)
class TrackersSend(Struct, frozen=True):
    """Thirty tracked points: locked flags, then x0, y0, x1, y1, ..."""

    locked: Annotated[Ints, "30i"] = (0,) * 30
    point_xy: Annotated[Ints, "60i"] = (0,) * 60


@option(16)
class VisionDetect(Struct, frozen=True):
    """Up to four tags that the drone itself detected; positions and sizes are 0..1000 for any frame size."""

    nb_detected: U32 = 0
    type: Annotated[Ints, "4I"] = _ZERO4
    xc: Annotated[Ints, "4I"] = _ZERO4
    yc: Annotated[Ints, "4I"] = _ZERO4
    width: Annotated[Ints, "4I"] = _ZERO4
    height: Annotated[Ints, "4I"] = _ZERO4
    dist_cm: Annotated[Ints, "4I"] = _ZERO4
    orientation_deg: Annotated[Floats, "4f"] = (0.0,) * 4
    rotation: Annotated[Floats, "36f"] = (0.0,) * 36
    translation: Annotated[Floats, "12f"] = (0.0,) * 12
    camera_source: Annotated[Ints, "4I"] = _ZERO4


@option(19)
class VideoStream(Struct, frozen=True):
    """The live encoder."""

    quant: U8 = 0
    frame_size: U32 = 0
    frame_number: U32 = 0
    atcmd_ref_seq: U32 = 0
    atcmd_mean_ref_gap_ms: U32 = 0
    atcmd_var_ref_gap: F32 = 0.0
    atcmd_ref_quality: U32 = 0
    out_bitrate: U32 = 0
    desired_bitrate: U32 = 0
    data: Annotated[Ints, "5i"] = (0, 0, 0, 0, 0)
    tcp_queue_level: U32 = 0
    fifo_queue_level: U32 = 0


@option(20)
class Games(Struct, frozen=True):
    """Counters of the drone's games."""

    double_tap_counter: U32 = 0
    finish_line_counter: U32 = 0


@option(25)
class HdvideoStream(Struct, frozen=True):
    """The state of the recorder; its bits are 0 FIFO full, 8 key present, 9 recording, 10 key full."""

    hdvideo_state: U32 = 0
    storage_fifo_nb_packets: U32 = 0
    storage_fifo_size: U32 = 0
    usbkey_size_kb: U32 = 0
    usbkey_freespace_kb: U32 = 0
    frame_number: U32 = 0
    usbkey_remaining_time_s: U32 = 0
