"""Stepping through a list with two joystick buttons: the original's way of choosing a trajectory."""

NEXT_BUTTON, PREVIOUS_BUTTON = 5, 4


class BumperSelector:
    """Index of what is selected; wraps around at both ends."""

    def __init__(self, count, next_button=NEXT_BUTTON, previous_button=PREVIOUS_BUTTON):
        """count: entries of the list.  Buttons: indices into the joystick's buttons."""
        if count < 1 or next_button == previous_button or min(next_button, previous_button) < 0:
            raise ValueError(
                "need at least one entry and two different buttons, got %r entries, buttons %r and %r"
                % (count, next_button, previous_button)
            )
        self.index = 0
        self._count = count
        self._steps = {next_button: 1, previous_button: -1}

    @property
    def buttons(self):
        """The two buttons."""
        return frozenset(self._steps)

    def press(self, buttons):
        """True when these buttons, pressed together, select another entry."""
        before = self.index
        self.index = (self.index + sum(self._steps.get(button, 0) for button in buttons)) % self._count
        return self.index != before
