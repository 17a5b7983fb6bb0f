"""A bounded run of the decoder's fuzzer; `./maap fuzz` runs it for longer."""

import pathlib
import re
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[1]


def test_cortex_decoder_survives_a_bounded_run(tmp_path, inputs):
    runs = inputs(30_000, 1_000_000)
    done = subprocess.run(
        [str(ROOT / "src/cortex_ros/test/fuzz/run.sh"), str(runs), str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=900,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    finished = re.search(r"Done (\d+) runs", done.stdout)
    assert finished and int(finished.group(1)) >= runs, done.stdout[-2000:]
