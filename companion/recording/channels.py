"""The topics of a recording and the messages that each holds."""

from typing import get_args

import msgspec

from companion.facts import records as rec
from companion.recording import foxglove as fox
from companion.recording.scene import SceneUpdate
from estimator.contracts.estimates import PathName
from estimator.contracts.fusion import Source

IMAGE, VIDEO = "/camera/image", "/camera/video"
ANNOTATIONS, CALIBRATION = "/camera/annotations", "/camera/calibration"
DETECTION, DECISION, TRUTH, LINK, HEALTH, LOG, TRANSFORMS = "/detection", "/decision", "/truth", "/link", "/health", "/log", "/tf"
ORDER = "/order"
"""The topic of people's orders and their answers."""
FIXED_TRANSFORMS = "/tf_static"
"""The topic of the transforms that do not change. A viewer that seeks takes a topic's newest message, so nothing else may be
written to this one; it is repeated each second for viewers that do not look further back."""
SCENE, ELLIPSOID = "/scene", "/scene/error"
"""The pad, the deck and the drone, repeated each second; and the error ellipsoid of the steering path."""
TRUE_POSE = "/pose/truth"
PATHS = get_args(PathName)


def belief(path: str) -> str:
    """Return the topic of an estimator path's estimates."""
    return f"/belief/{path}"


def fusion(source: str) -> str:
    """Return the topic of the fusion results of a source of measurements."""
    return f"/fusion/{source}"


def pose(path: str) -> str:
    """Return the topic of an estimator path's pose."""
    return f"/pose/{path}"


SAMPLES: dict[type[msgspec.Struct], str] = {
    rec.ImuRecord: "/sample/imu",
    rec.AttitudeRecord: "/sample/attitude",
    rec.GimbalRecord: "/sample/gimbal",
    rec.VelocityRecord: "/sample/velocity",
    rec.RangeRecord: "/sample/range",
    rec.BaroRecord: "/sample/baro",
    rec.VesselRecord: "/sample/vessel",
    rec.FixRecord: "/sample/fix",
    rec.StatusRecord: "/sample/status",
}

TOPICS: dict[str, type[msgspec.Struct]] = {
    **{topic: kind for kind, topic in SAMPLES.items()},
    DETECTION: rec.DetectionRecord,
    **{belief(path): rec.BeliefRecord for path in PATHS},
    **{fusion(source): rec.FusionRecord for source in get_args(Source)},
    DECISION: rec.DecisionRecord,
    ORDER: rec.OrderRecord,
    TRUTH: rec.TruthRecord,
    LINK: rec.LinkRecord,
    HEALTH: rec.HealthRecord,
    IMAGE: fox.CompressedImage,
    VIDEO: fox.CompressedVideo,
    ANNOTATIONS: fox.ImageAnnotations,
    CALIBRATION: fox.CameraCalibration,
    TRANSFORMS: fox.FrameTransforms,
    FIXED_TRANSFORMS: fox.FrameTransforms,
    **{pose(path): fox.PoseInFrame for path in (*PATHS, "truth")},
    LOG: fox.Log,
    SCENE: SceneUpdate,
    ELLIPSOID: SceneUpdate,
}


def schema_name(kind: type[msgspec.Struct]) -> str:
    """Return the name of a record's schema, such as `foxglove.PoseInFrame` or `decklander.Detection`."""
    if kind.__module__ in (fox.__name__, SceneUpdate.__module__):
        return f"foxglove.{kind.__name__}"
    return f"decklander.{kind.__name__.removesuffix('Record')}"
