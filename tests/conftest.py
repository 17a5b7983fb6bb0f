import pathlib
import sys

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "benchmarks")]  # flying.py, labelled_pictures.py ...
