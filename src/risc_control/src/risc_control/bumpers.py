"""Stepping through a list with two joystick buttons, by edge: the original's way of choosing a trajectory."""

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
        self._buttons = (next_button, 1), (previous_button, -1)
        self._held = {button: True for button, _ in self._buttons}  # held at the start is no press

    def update(self, buttons):
        """True when these button values (0 or 1 each) select another entry."""
        before = self.index
        for button, step in self._buttons:
            pressed = button < len(buttons) and bool(buttons[button])
            if pressed and not self._held[button]:
                self.index = (self.index + step) % self._count
            self._held[button] = pressed
        return self.index != before
