"""The definitions of the original, and messages of a device against those of the workspace."""

import struct

import pytest
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool

from risc_msgs.msg import Control, Controls
from rosserial_msgs.msg import Log, TopicInfo
from rosserial_msgs.srv import RequestParam, RequestParamRequest
from rosserial_python import protocol
from rosserial_python.protocol import ANNOUNCEMENTS, Id, PayloadError, Topic
from rosserial_python.ros.definitions import TypesError, known_class, read_message, serialised

MD5SUMS = {
    TopicInfo: "0ad51f88fc44892f8c10684077646005",
    Log: "11abd731c25933261cd6183bd12d6295",
    RequestParam: "d7a0c2be00c9fd03cc69f2863de9c4d9",
}


@pytest.mark.parametrize("kind", MD5SUMS)
def test_definitions_are_those_of_the_original(kind):
    assert kind._md5sum == MD5SUMS[kind]


def test_ids_are_those_of_the_definition():
    assert (TopicInfo.ID_PUBLISHER, TopicInfo.ID_SUBSCRIBER) == (Id.PUBLISHER, Id.SUBSCRIBER)
    assert TopicInfo.ID_SERVICE_SERVER + TopicInfo.ID_PUBLISHER == Id.SERVER_RESPONSE
    assert TopicInfo.ID_SERVICE_SERVER + TopicInfo.ID_SUBSCRIBER == Id.SERVER_REQUEST
    assert TopicInfo.ID_SERVICE_CLIENT + TopicInfo.ID_PUBLISHER == Id.CLIENT_REQUEST
    assert TopicInfo.ID_SERVICE_CLIENT + TopicInfo.ID_SUBSCRIBER == Id.CLIENT_RESPONSE
    assert (TopicInfo.ID_PARAMETER_REQUEST, TopicInfo.ID_LOG) == (Id.PARAMETER, Id.LOG)
    assert (TopicInfo.ID_TIME, TopicInfo.ID_TX_STOP) == (Id.TIME, Id.TX_STOP)
    assert set(range(6)) == ANNOUNCEMENTS


def test_payloads_are_what_genpy_makes_of_the_messages():
    info = TopicInfo(125, "chatter", "std_msgs/String", String._md5sum, 512)
    assert protocol.topic_of(serialised(info)) == Topic(125, "chatter", "std_msgs/String", String._md5sum, 512)
    assert protocol.log_of(serialised(Log(Log.ERROR, "text"))) == (3, "text")
    assert protocol.name_of(serialised(RequestParamRequest("~rate"))) == "~rate"


def topic(kind, **other):
    return Topic(100, "x", kind._type, kind._md5sum, 512)._replace(**other)


def test_a_definition_that_is_the_same_here():
    assert known_class(topic(Controls)) is Controls
    half = topic(SetBool, md5sum=SetBool._request_class._md5sum)
    assert known_class(half, "_request_class") is SetBool


@pytest.mark.parametrize(
    ("wrong", "half"),
    [
        (topic(Controls, md5sum=32 * "0"), None),
        (topic(Controls, type="risc_msgs/NoSuchType"), None),
        (topic(Controls, type="no_such_package/Type"), None),
        (topic(SetBool), "_request_class"),
    ],
)
def test_a_definition_that_is_another_one_or_none(wrong, half):
    with pytest.raises(TypesError, match="x"):
        known_class(wrong, half)


def test_a_payload_is_one_whole_message():
    message = Controls(Header(frame_id="cortex"), [Control("IRIS", 0.1, 0.2, 0.3, 0.4)])
    data = serialised(message)
    assert read_message(Controls, data) == message
    for wrong in (data[:-1], data + b"\0", b"", data[:22] + struct.pack("<I", 2) + data[26:]):
        with pytest.raises(PayloadError):
            read_message(Controls, wrong)
    with pytest.raises(PayloadError):
        read_message(String, struct.pack("<I", 100) + b"x")
