"""The topics of a recording, the messages that each holds, and their schemas.

The schemas are in the subset of JSON Schema that viewers of MCAP files read. Foxglove and Lichtblick know objects, arrays,
numbers, integers, booleans, text and base64; no references, unions or nulls. A field that may be None is therefore left out of
the message where it is None, and out of `required`.
"""

from typing import Any, get_args

import msgspec
from msgspec import inspect

from companion.facts import records as rec
from companion.recording import foxglove as fox
from companion.recording.foxglove import SceneUpdate
from estimator.contracts.estimates import SOURCES, PathName, Source
from estimator.contracts.samples import Sample

SETTINGS, CAMERA, PAD = "settings.toml", "camera.toml", "pad.toml"
"""The attachments of a recording."""
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


SAMPLES: dict[type[Sample], str] = {kind: f"/sample/{SOURCES[kind]}" for kind in rec.SAMPLES}
"""The topic of each kind of sample."""
TOPICS: dict[str, type[msgspec.Struct]] = {
    **{SAMPLES[kind]: record for kind, record in rec.SAMPLES.items()},
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


FOR_VIEWERS = {topic for topic, kind in TOPICS.items() if schema_name(kind).startswith("foxglove.")} - {IMAGE, VIDEO}
"""Topics that repeat for viewers what others hold."""


def json_schema(kind: type[msgspec.Struct], name: str) -> dict[str, Any]:
    """Return the schema, called `name`, of a struct whose fields are numbers, text, bytes, lists and other structs.

    Raises:
        TypeError: a field of another type.
    """
    return {"title": name, **_schema(inspect.type_info(kind))}


def _schema(of: inspect.Type) -> dict[str, Any]:
    match of:
        case inspect.Metadata():
            return _schema(of.type) | dict(of.extra_json_schema or {})
        case inspect.StructType():
            required = [f.encode_name for f in of.fields if f.required]
            out: dict[str, Any] = {"type": "object", "properties": {f.encode_name: _schema(f.type) for f in of.fields}}
            return out | ({"required": required} if required else {})
        case inspect.ListType():
            return {"type": "array", "items": _schema(of.item_type)}
        case inspect.UnionType():
            kinds = [t for t in of.types if not isinstance(t, inspect.NoneType)]
            if len(kinds) == 1:
                return _schema(kinds[0])
        case inspect.BytesType():
            return {"type": "string", "contentEncoding": "base64"}
        case inspect.StrType() | inspect.LiteralType() | inspect.EnumType():
            return {"type": "string"}
        case inspect.BoolType():
            return {"type": "boolean"}
        case inspect.IntType():
            return {"type": "integer"}
        case inspect.FloatType():
            return {"type": "number"}
    raise TypeError(f"no viewer reads {of!r}")
