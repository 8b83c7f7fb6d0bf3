# SPDX-License-Identifier: Apache-2.0
"""Size of a mechanism, of which an accuracy is a part."""

import pytest
from scene_files import text_of

from liegroup_core.layout import make_layout
from liegroup_core.scene.load import scene_from_text

BALL = text_of("ball_size.yaml")
LINE = "joints:\n  - {name: line, type: TYPE, parent: world, child: ball, parent_frame: {}, child_frame: {}"
SMALL = "0.02, 0.02, 0.02"


@pytest.mark.parametrize(
    "inertia, joint, size",
    [
        (SMALL, "", 0.03**0.5),  # sqrt(trace(I) / m)
        (SMALL, LINE.replace("TYPE", "distance") + "}", 3.0),
        (SMALL, LINE.replace("TYPE", "distance") + ", length: 3.0}", 3.0),
        (SMALL, LINE.replace("TYPE", "cable") + ", length: 4.0}", 4.0),
        (SMALL, LINE.replace("TYPE", "strut") + ", length: 2.0}", 2.0),
    ],
)
def test_size_is_the_largest_length(inertia, joint, size):
    scene = scene_from_text(BALL.replace("INERTIA", inertia) + joint)
    assert make_layout(scene).size == pytest.approx(size, rel=1e-15)
