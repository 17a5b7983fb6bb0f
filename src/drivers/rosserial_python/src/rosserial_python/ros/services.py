"""Services of a device: those that it offers, and those that it calls. Each is announced in two halves."""

import queue
import threading

import rospy

from rosserial_python.link import State
from rosserial_python.protocol import Id
from rosserial_python.ros.definitions import known_class, read_message, serialised

_ANSWER_S = 5.0  # a device that has not answered by then will not answer


class _Half:
    """One half of a service."""

    message = None  # "_request_class" or "_response_class"

    def __init__(self, topics, topic):
        self.topics, self.topic = topics, topic
        self.service_class = known_class(topic, self.message)
        self.message_class = getattr(self.service_class, self.message)

    def confirmed(self, topic):
        self.topics.session.confirm(topic)

    def from_device(self, _payload):
        """Do nothing: most halves receive nothing from the device."""

    def close(self):
        """Do nothing: most halves are not registered in the graph."""


class ServerResponse(_Half):
    """Responses of a service that the device offers."""

    message = "_response_class"

    def __init__(self, topics, topic):
        super().__init__(topics, topic)
        self.answers = queue.SimpleQueue()

    def from_device(self, payload):
        self.answers.put(read_message(self.message_class, payload))


class ServerRequest(_Half):
    """Requests to a service that the device offers: holds the ROS service."""

    message = "_request_class"

    def __init__(self, topics, topic):
        super().__init__(topics, topic)
        self._turn = threading.Lock()  # one call at a time: a device's answer does not name its request
        self._service = rospy.Service(topic.name, self.service_class, self._call)
        rospy.loginfo("serves %s [%s]", topic.name, topic.type)

    def _call(self, request):
        topic, data = self.topic, serialised(request)
        with self._turn:
            half = self.topics.member(Id.SERVER_RESPONSE, topic.name)
            if half is None or self.topics.session.link.facts.state is not State.UP:
                raise rospy.ServiceException("%s: the device is not connected" % topic.name)
            if not self.topics.fits(topic, len(data)):
                raise rospy.ServiceException("%s: the request exceeds the device's buffer" % topic.name)
            answers = half.answers
            while not answers.empty():  # an answer that came too late
                answers.get()
            self.topics.session.reply(topic.topic_id, data)
            try:
                return answers.get(timeout=_ANSWER_S)
            except queue.Empty:
                raise rospy.ServiceException("%s: no answer within %g s" % (topic.name, _ANSWER_S)) from None

    def close(self):
        self._service.shutdown("the device has another program, or the node shuts down")


class ClientResponse(_Half):
    """Responses to service calls of the device."""

    message = "_response_class"


class ClientRequest(_Half):
    """Service calls of the device."""

    message = "_request_class"

    def __init__(self, topics, topic):
        super().__init__(topics, topic)
        self._proxy = rospy.ServiceProxy(topic.name, self.service_class)
        rospy.loginfo("calls %s [%s] for the device", topic.name, topic.type)

    def from_device(self, payload):
        request = read_message(self.message_class, payload)
        threading.Thread(target=self._call, args=(request,), name="call of %s" % self.topic.name, daemon=True).start()

    def _call(self, request):
        """Call the service. Runs in its own thread, so that the line goes on while the device waits."""
        try:
            response = self._proxy(request)
        except (rospy.ServiceException, rospy.ROSException) as error:
            rospy.logerr("the device calls %s: %s", self.topic.name, error)
            return
        half, data = self.topics.member(Id.CLIENT_RESPONSE, self.topic.name), serialised(response)
        if half is not None and self.topics.fits(half.topic, len(data)):
            self.topics.session.reply(half.topic.topic_id, data)


HALVES = {
    Id.SERVER_RESPONSE: ServerResponse,
    Id.SERVER_REQUEST: ServerRequest,
    Id.CLIENT_REQUEST: ClientRequest,
    Id.CLIENT_RESPONSE: ClientResponse,
}
