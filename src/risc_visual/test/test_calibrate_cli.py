"""calibrate.py: every problem is one line that names cause and cure; and pictures out of folders and bags."""

import functools
import pathlib
import re

import cv2
import numpy as np
import pytest
import rosbag
import rospy
from run_programs import run_program
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import String

from risc_lab.images import PictureError
from risc_visual.vision.picture_source import open_pictures

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "calibrate.py"


run = functools.partial(run_program, NODE)


def error_of(folder, *arguments):
    """The one line of its error; asserts that nothing is written."""
    done = run(folder, *arguments)
    assert done.returncode == 1 and done.stdout == "", done.stdout + done.stderr
    assert done.stderr.startswith("calibrate.py: ") and done.stderr.count("\n") == 1, done.stderr
    assert list(pathlib.Path(folder).glob("*.yaml")) == []
    return done.stderr


def board_picture(columns, rows, square_px=30):
    colours = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2 * 200 + 20
    picture = np.kron(colours, np.ones((square_px, square_px))).astype(np.uint8)
    return cv2.copyMakeBorder(picture, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=220)


@pytest.fixture
def pictures(tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    return folder


def test_nothing_there(tmp_path):
    assert "nowhere" in error_of(tmp_path, "nowhere")


def test_folder_without_pictures(tmp_path, pictures):
    (pictures / "notes.txt").write_text("no picture")
    assert ".png" in error_of(tmp_path, pictures)


def test_no_board_in_sight(tmp_path, pictures):
    for k in range(3):
        cv2.imwrite(str(pictures / ("%d.png" % k)), np.full((360, 640), 100 + k, np.uint8))
    text = error_of(tmp_path, pictures)
    assert "0 of 3 pictures" in text and "8x6" in text


def test_another_board_is_named(tmp_path, pictures):
    for k in range(3):
        cv2.imwrite(str(pictures / ("%d.png" % k)), board_picture(7, 5))
    assert "--size 7x5" in error_of(tmp_path, pictures)


def test_pictures_of_two_sizes(tmp_path, pictures):
    cv2.imwrite(str(pictures / "a.png"), np.zeros((360, 640), np.uint8))
    cv2.imwrite(str(pictures / "b.png"), np.zeros((480, 640), np.uint8))
    assert re.search("b.png .* 640 x 480, .*a.png .* 640 x 360", error_of(tmp_path, pictures))


def test_damaged_pictures(tmp_path, pictures):
    (pictures / "a.png").write_bytes(b"not a picture")
    done = run(tmp_path, pictures)
    assert done.returncode == 1
    assert "1 of 1 pictures" in done.stderr and "none of the 1 pictures" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--size", "8by6"), "COLUMNSxROWS"),
        (("--square", "0"), "square_m"),
        (("--max-pictures", "0"), "--max-pictures"),
        (("--out", "gone/risc1.yaml"), "folder gone"),
        (("--topic", "/camera/image_raw"), "bags"),
    ],
)
def test_bad_arguments(tmp_path, pictures, arguments, says):
    cv2.imwrite(str(pictures / "a.png"), board_picture(8, 6))
    assert says in error_of(tmp_path, pictures, *arguments)


def image(picture, encoding, padding=0):
    rows = np.pad(picture.reshape(picture.shape[0], -1), ((0, 0), (0, padding)), constant_values=77)
    message = Image(height=picture.shape[0], width=picture.shape[1], encoding=encoding, step=rows.shape[1])
    message.data = rows.tobytes()
    return message


def write_bag(path, messages):
    """messages: (topic, message)."""
    with rosbag.Bag(str(path), "w") as bag:
        for k, (topic, message) in enumerate(messages):
            stamp = rospy.Time(100 + k, 5)
            if hasattr(message, "header"):
                message.header.stamp = stamp
            bag.write(topic, message, stamp)
    return path


def test_bag_without_pictures(tmp_path):
    bag = write_bag(tmp_path / "talk.bag", [("/talk", String("no picture"))])
    assert "image_raw" in error_of(tmp_path, bag)


def test_bag_topics_are_named(tmp_path):
    picture = np.zeros((36, 64), np.uint8)
    topics = [("/front/image_raw", image(picture, "mono8"))] * 2 + [("/bottom/image_raw", image(picture, "mono8"))]
    bag = write_bag(tmp_path / "two.bag", topics + [("/talk", String("no picture"))])
    listing = "/bottom/image_raw (1), /front/image_raw (2)"
    assert listing in error_of(tmp_path, bag)
    assert re.search(" /talk; .*" + re.escape(listing), error_of(tmp_path, bag, "--topic", "/talk"))


def test_bag_that_is_none(tmp_path):
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n and then nothing")
    assert "rosbag reindex" in error_of(tmp_path, tmp_path / "broken.bag")


def test_pictures_of_a_bag_are_grey_whatever_their_encoding(tmp_path):
    grey = np.tile(np.arange(0, 256, 4, dtype=np.uint8), (36, 1))
    colour = np.zeros((36, 64, 3), np.uint8)
    colour[..., 0] = 200  # blue in bgr8, red in rgb8
    png = CompressedImage(format="png", data=cv2.imencode(".png", grey)[1].tobytes())
    messages = [
        image(grey, "mono8"),
        image(grey, "mono8", padding=16),
        image(np.repeat(grey[..., None], 3, axis=2), "rgb8", padding=4),
        image(colour, "bgr8"),
        image(colour, "rgb8"),
        image(grey, "no_such_encoding"),
    ]
    bag = write_bag(tmp_path / "all.bag", [("/camera/image_raw", message) for message in messages])
    names, read = zip(*open_pictures(bag)[2])
    assert names[:2] == ("100.000000005", "101.000000005")
    for picture in read[:3]:
        assert np.array_equal(picture, grey)
    assert abs(int(read[3][0, 0]) - 0.114 * 200) <= 1 and abs(int(read[4][0, 0]) - 0.299 * 200) <= 1
    assert read[5] is None
    compressed = write_bag(tmp_path / "compressed.bag", [("/camera/image_raw/compressed", png)])
    assert np.array_equal(next(open_pictures(compressed)[2])[1], grey)


def test_many_pictures_are_thinned_evenly(tmp_path, pictures):
    for k in range(20):
        cv2.imwrite(str(pictures / ("%02d.png" % k)), np.full((4, 4), 10 * k, np.uint8))
    _, count, found = open_pictures(pictures, most=5)
    assert count == 5
    assert [name for name, _ in found] == ["00.png", "05.png", "10.png", "14.png", "19.png"]
    grey = np.zeros((4, 4), np.uint8)
    bag = write_bag(tmp_path / "many.bag", [("/image_raw", image(grey, "mono8")) for _ in range(20)])
    assert len(list(open_pictures(bag, most=7)[2])) == 7


def test_a_topic_of_a_folder_is_refused(pictures):
    with pytest.raises(PictureError, match="bags"):
        open_pictures(pictures, "/image_raw")
