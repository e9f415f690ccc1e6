"""Use atheris (libFuzzer) as the engine for functions in process: mutation guided by code coverage.

It runs in its own process (:mod:`dcp_selftest.fuzz.atheris_child`) until a limit is reached. The campaign
then repeats, minimises and keeps its findings like those of its own generator.
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from dcp_conformance.errors import UsageError
from dcp_lab.fuzz.campaign import Campaign, Limits
from dcp_lab.fuzz.reduce.reduction import not_minimised
from dcp_lab.fuzz.steps import Effect, Frame, Step

from .atheris_child import ChildSettings

#: Maximum length of an input in octets; no beacon is longer.
_LONGEST = 1500
#: Seconds after which libFuzzer reports a hang.
_TIMEOUT = 10
#: Maximum number of starts of the process, which ends after each hang or crash.
_STARTS = 20
_RUNS = re.compile(r"stat::number_of_executed_units:\s*(\d+)")


class _Gathered:
    """A generator that returns the given inputs in order."""

    def __init__(self, part: str, inputs: Sequence[bytes]) -> None:
        self.kinds: tuple[str, ...] = (part,)
        self._inputs = list(inputs)

    def draw(self) -> list[Step]:
        return [Frame(self._inputs.pop(0), b"", self.kinds[0])]

    def keep(self, steps: list[Step]) -> None:
        """Do nothing: this generator does not mutate."""


def run_engine(campaign: Campaign, part: str, profile: str, seeds: Sequence[bytes], limits: Limits) -> None:
    """Fuzz ``part`` with atheris in a profile (name or path), and add its findings to the campaign.

    The corpus starts with ``seeds``. If the campaign has a folder for artefacts, the corpus is stored there
    (``corpus-PART``) and continued by the next campaign. After Ctrl-C the findings so far are kept. Raises
    :class:`UsageError` if atheris is not installed.
    """
    if importlib.util.find_spec("atheris") is None:
        raise UsageError("atheris is not installed: pip install 'atheris>=3.0'")
    begun = time.monotonic()
    interrupted: KeyboardInterrupt | None = None
    with tempfile.TemporaryDirectory(prefix="dcp-fuzz-") as name:
        folder = Path(name)
        corpus = folder / "corpus" if campaign.directory is None else campaign.directory / f"corpus-{part}"
        corpus.mkdir(parents=True, exist_ok=True)
        for number, octets in enumerate(seeds):
            (corpus / f"seed-{number}").write_bytes(octets)
        settings = ChildSettings(profile, part, campaign.seed, str(folder / "findings"))
        try:
            for runs in _children(settings, folder, corpus, limits, begun):
                campaign.state.cases += runs
        except KeyboardInterrupt as error:
            interrupted = error
        inputs, hangs = gathered(folder)
    campaign.state.seconds += time.monotonic() - begun
    for octets in hangs:
        # A hang cannot be repeated in this process.
        campaign.keep(not_minimised([Frame(octets, b"", part)], Effect("hang", f"{part}: it ended atheris", 0, part)))
    campaign.generator = _Gathered(part, inputs)
    campaign.run(Limits(cases=len(inputs)))
    if interrupted is not None:
        raise interrupted


def _children(settings: ChildSettings, folder: Path, corpus: Path, limits: Limits, begun: float) -> Iterator[int]:
    """Run processes in succession until a limit is reached. Yields the number of tests of each."""
    done = 0
    for _ in range(_STARTS):
        left = None if limits.seconds is None else round(limits.seconds - (time.monotonic() - begun))
        if (left is not None and left <= 0) or (limits.cases is not None and done >= limits.cases):
            return
        options = [f"-max_len={_LONGEST}", f"-timeout={_TIMEOUT}", f"-seed={settings.seed}", "-print_final_stats=1"]
        options.append(f"-artifact_prefix={folder}/")
        if left is not None:
            options.append(f"-max_total_time={left}")
        if limits.cases is not None:
            options.append(f"-runs={limits.cases - done}")
        command = [
            sys.executable,
            "-m",
            "dcp_selftest.fuzz.atheris_child",
            msgspec.json.encode(settings).decode(),
        ]
        with (folder / "log").open("w+") as log:
            subprocess.run([*command, *options, str(corpus)], stdout=log, stderr=log, check=False)  # noqa: S603
            log.seek(0)
            output = log.read()
        found = _RUNS.search(output)
        if found is None:
            raise UsageError(f"--engine atheris: it does not run: {output.strip()[-400:]}")
        done += int(found[1])
        yield int(found[1])


def gathered(folder: Path) -> tuple[list[bytes], list[bytes]]:
    """Return the inputs that had an effect, and the inputs at which libFuzzer ended the process."""
    path = folder / "findings"
    lines = path.read_text().splitlines() if path.exists() else []
    ended = [each for kind in ("timeout", "oom", "crash") for each in sorted(folder.glob(f"{kind}-*"))]
    return [bytes.fromhex(line) for line in lines], [each.read_bytes() for each in ended]
