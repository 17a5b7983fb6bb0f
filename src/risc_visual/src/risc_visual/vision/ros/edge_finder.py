"""The node behind edge_drone and edge_uvc: one program, two cameras. The work is in vision.templates.edges."""

from risc_visual.cfg import EdgesConfig
from risc_visual.vision.ros.picture_node import PictureNode
from risc_visual.vision.templates.edges import EdgeSettings, find_edges


class EdgeFinder(PictureNode):
    """Pictures -> camera/image_edge."""

    def __init__(self, topic):
        super().__init__(topic, {"camera/image_edge": "mono8"}, EdgeSettings, EdgesConfig)

    def process(self, picture, header):
        self.publish("camera/image_edge", find_edges(picture, self.settings), header)
