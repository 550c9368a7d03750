"""The edges of the drawing lie between the paints that they divide."""

import numpy as np

from estimator.vision.drawing import EdgeKind, edges_of
from tests.support.pad_images import _paint
from tests.support.shipped import shipped_pad

PADS = [shipped_pad("thesis"), shipped_pad("printed")]


def test_edges_lie_between_the_two_paints() -> None:
    for pad in PADS:
        e = edges_of(pad)
        inside, outside = (_paint(at[:, 0], at[:, 1], pad) for at in (e.at_m - 1e-3 * e.normal, e.at_m + 1e-3 * e.normal))
        for kind, paints in ((EdgeKind.RING, (3, 2)), (EdgeKind.ARROW, (3, 2)), (EdgeKind.H, (4, 2))):
            of = e.kind == kind
            assert set(inside[of]) == {paints[0]}
            assert set(outside[of]) == {paints[1]}
        of = e.kind == EdgeKind.DISC
        assert set(inside[of]) == {2}
        assert set(outside[of]) == ({1} if pad.markings.rim_width_m else {0})
        assert np.all(np.diff(e.kind) >= 0)
        assert np.all(np.diff(e.piece) >= 0)
