"""STATUSTEXT: long texts come in pieces."""

_PIECE = 50  # characters in a full one


class Texts:
    """Puts the pieces of texts together again."""

    def __init__(self):
        self._id, self._severity, self._pieces = 0, 0, []

    def add(self, message):
        """A STATUSTEXT -> list of (severity, text) that are complete."""
        complete = []
        if self._pieces and (message.id != self._id or message.chunk_seq != len(self._pieces)):
            complete += self.flush()  # its end is lost
        if not message.id:
            return [*complete, (message.severity, message.text)]
        self._id, self._severity = message.id, message.severity
        self._pieces.append(message.text)
        if len(message.text) < _PIECE:
            complete += self.flush()
        return complete

    def flush(self):
        """What there is of a text whose end does not come."""
        pieces, self._pieces = self._pieces, []
        return [(self._severity, "".join(pieces))] if pieces else []
