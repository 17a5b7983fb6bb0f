import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))  # hover_desk.py, joystick_desk.py
