"""STATUSTEXT: long texts come in pieces."""

_PIECE = 50  # characters in a full piece


class Texts:
    """Joins the pieces of texts."""

    def __init__(self):
        self._id, self._severity, self._pieces = 0, 0, []

    def add(self, message):
        """Add a STATUSTEXT; return the list of complete (severity, text)."""
        complete = []
        if self._pieces and (message.id != self._id or message.chunk_seq != len(self._pieces)):
            complete += self.flush()  # the end of the previous text is lost
        if not message.id:
            return [*complete, (message.severity, message.text)]
        self._id, self._severity = message.id, message.severity
        self._pieces.append(message.text)
        if len(message.text) < _PIECE:
            complete += self.flush()
        return complete

    def flush(self):
        """Return the received pieces of a text whose end is missing, as list of (severity, text)."""
        pieces, self._pieces = self._pieces, []
        return [(self._severity, "".join(pieces))] if pieces else []
