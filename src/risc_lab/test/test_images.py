"""Messages of every kind, and files, become pictures; what cannot is refused in one sentence."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from cv_bridge import CvBridge
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from risc_lab.images import PictureError, picture_from_file, picture_from_msg

BGR = np.array([[(1, 2, 3), (40, 50, 60)], [(7, 8, 9), (100, 110, 120)]], np.uint8)
CHANNELS = {"bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "mono": 1}
CHANNELS.update(dict.fromkeys(("bayer_rggb", "bayer_bggr", "bayer_gbrg", "bayer_grbg"), 1))


def message(encoding, array, step=None):
    row_bytes = array[0].nbytes
    step = row_bytes if step is None else step
    data = b"".join(row.tobytes() + bytes(max(0, step - row_bytes)) for row in array)
    return Image(height=array.shape[0], width=array.shape[1], encoding=encoding, step=step, data=data)


@pytest.mark.parametrize("padding", [0, 1, 10])
def test_colours_come_out_in_order_with_and_without_padding(padding):
    assert np.array_equal(picture_from_msg(message("bgr8", BGR, 6 + padding)), BGR)
    assert np.array_equal(picture_from_msg(message("rgb8", BGR[..., ::-1].copy(), 6 + padding)), BGR)


def test_grey_and_alpha_become_three_channels():
    grey = BGR[..., 0].copy()
    assert np.array_equal(picture_from_msg(message("mono8", grey)), np.repeat(grey[..., None], 3, axis=2))
    alpha = np.dstack((BGR, np.full((2, 2), 255, np.uint8)))
    assert np.array_equal(picture_from_msg(message("bgra8", alpha)), BGR)


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("name", sorted(CHANNELS))
def test_every_encoding_is_what_cv_bridge_makes_of_it(name, depth):
    numbers = np.random.default_rng(depth).integers(0, 2**depth, (8, 10, CHANNELS[name])).astype("<u%d" % (depth // 8))
    sent = message("%s%d" % (name, depth), numbers)
    expected = CvBridge().imgmsg_to_cv2(sent, "bgr8").astype(int)
    # cv_bridge rounds where the upper bits are kept here
    assert np.abs(picture_from_msg(sent) - expected).max() <= (0 if depth == 8 else 2)


def test_pairs_of_brightness_and_colour_are_what_cv_bridge_makes_of_them():
    sent = message("yuv422", np.random.default_rng(1).integers(0, 256, (8, 10, 2)).astype(np.uint8))
    assert np.array_equal(picture_from_msg(sent), CvBridge().imgmsg_to_cv2(sent, "bgr8"))


def test_the_order_of_bytes_is_that_of_the_message():
    numbers = np.array([[0x1234, 0xFE01]])
    big, little = message("mono16", numbers.astype(">u2")), message("mono16", numbers.astype("<u2"))
    big.is_bigendian = 1
    for sent in (big, little):
        assert picture_from_msg(sent)[0].tolist() == [[0x12] * 3, [0xFE] * 3]


@pytest.mark.parametrize("encoding", ["bgr8", "rgb8"])
def test_the_picture_may_be_drawn_on_without_changing_the_message(encoding):
    sent = message(encoding, BGR)
    before = picture_from_msg(sent)
    picture_from_msg(sent)[:] = 0
    assert np.array_equal(picture_from_msg(sent), before)


def test_a_compressed_picture():
    sent = CompressedImage(format="bgr8; png compressed bgr8", data=cv2.imencode(".png", BGR)[1].tobytes())
    assert np.array_equal(picture_from_msg(sent), BGR)


def png_of_size(width, height):
    """A PNG whose header gives a wrong size."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    file = bytearray(cv2.imencode(".png", BGR)[1].tobytes())
    file[12:33] = header + struct.pack(">I", zlib.crc32(header))
    return bytes(file)


@pytest.mark.parametrize(
    "wrong, why",
    [
        (Image(), "empty"),
        (message("nonsense", BGR), "encoding 'nonsense'"),
        (message("32FC1", np.zeros((2, 2), np.float32)), "encoding '32FC1'"),
        (message("bgr8", BGR, 5), "rows of 6 bytes"),
        (Image(height=2, width=2, encoding="bgr8", step=6, data=bytes(11)), "11 bytes in all"),
        (Image(height=10**6, width=10**6, encoding="bgr8", step=3 * 10**6, data=b""), "0 bytes in all"),
        (message("yuv422", np.zeros((2, 3, 2), np.uint8)), "3 x 2.*yuv422"),
        (CompressedImage(format="jpeg", data=b""), r"\(jpeg\)"),
        (CompressedImage(format="jpeg", data=b"no picture"), "damaged"),
        (CompressedImage(format="png", data=png_of_size(10**6, 10**6)), r"\(png\)"),
        (String("a picture"), "no picture but"),
    ],
)
def test_what_cannot_become_a_picture_is_refused(wrong, why):
    with pytest.raises(PictureError, match=why):
        picture_from_msg(wrong)


def test_files(tmp_path):
    cv2.imwrite(str(tmp_path / "good.png"), BGR)
    assert np.array_equal(picture_from_file(tmp_path / "good.png"), BGR)
    (tmp_path / "text.png").write_text("no picture")
    for name, why in (("gone.png", "no such file"), ("text.png", "it is no picture"), (".", "it is a folder")):
        with pytest.raises(PictureError, match=why):
            picture_from_file(tmp_path / name)
