"""Messages of every kind become pictures; what cannot is refused in one sentence."""

import numpy as np
import pytest
from sensor_msgs.msg import Image

from risc_visual.ros.picture_node import picture_from_msg


def message(encoding, array, step=None):
    row_bytes = array[0].nbytes
    step = row_bytes if step is None else step
    data = b"".join(row.tobytes() + bytes(max(0, step - row_bytes)) for row in array)
    return Image(height=array.shape[0], width=array.shape[1], encoding=encoding, step=step, data=data)


BGR = np.array([[(1, 2, 3), (40, 50, 60)], [(7, 8, 9), (100, 110, 120)]], np.uint8)


@pytest.mark.parametrize("padding", [0, 1, 10])
def test_colours_come_out_in_order_with_and_without_padding(padding):
    assert np.array_equal(picture_from_msg(message("bgr8", BGR, 6 + padding)), BGR)
    assert np.array_equal(picture_from_msg(message("rgb8", BGR[..., ::-1].copy(), 6 + padding)), BGR)


def test_grey_and_alpha_become_three_channels():
    grey = BGR[..., 0].copy()
    assert np.array_equal(picture_from_msg(message("mono8", grey)), np.repeat(grey[..., None], 3, axis=2))
    alpha = np.dstack((BGR, np.full((2, 2), 255, np.uint8)))
    assert np.array_equal(picture_from_msg(message("bgra8", alpha)), BGR)


def test_the_picture_may_be_drawn_on_without_changing_the_message():
    sent = message("bgr8", BGR)
    picture_from_msg(sent)[:] = 0
    assert np.array_equal(picture_from_msg(sent), BGR)


@pytest.mark.parametrize(
    "wrong, why",
    [
        (Image(), "empty"),
        (message("nonsense", BGR), "encoding 'nonsense'"),
        (message("32FC1", np.zeros((2, 2), np.float32)), "encoding '32FC1'"),
        (message("bgr8", BGR, 5), "rows of 6 bytes"),
        (Image(height=2, width=2, encoding="bgr8", step=6, data=bytes(11)), "11 bytes in all"),
        (Image(height=10**6, width=10**6, encoding="bgr8", step=3 * 10**6, data=b""), "0 bytes in all"),
    ],
)
def test_what_cannot_become_a_picture_is_refused(wrong, why):
    with pytest.raises(ValueError, match=why):
        picture_from_msg(wrong)
