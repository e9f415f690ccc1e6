"""Seeded faults: how soon the fuzzer finds nodes that die, go mute or hold a wrong state, and in how many frames.

    python benchmarks/fuzz_mutants.py [--seconds N] [--seed N] [--all] [--json FILE] [MUTANT...]

Each mutant gets a campaign of its own against the stack in process, with the same seed, which ends with the first
finding. Without names, those below; --all takes every mutant whose fault can show at a node that listens and answers.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from pathlib import Path
from typing import Any

from dcp_conformance.fuzz.campaign import Campaign, Limits
from dcp_conformance.fuzz.findings.artefact import SavedTarget
from dcp_conformance.fuzz.generate.sequences import Sequences
from dcp_conformance.fuzz.generate.sweep import SweepFirst
from dcp_selftest.fuzz.lifetimes import Lifetimes
from dcp_selftest.fuzz.targets import stack_target
from dcp_selftest.mutants import Mutant, all_mutants

from dcp_codec.codec import Codec
from dcp_codec.testing.mutation import Mutator, drawn_pool

CHOSEN = (
    # Crashes.
    "M-BP-RX-15-dies", "M-BP-RX-16-dies-of-short", "M-BP-RX-16-dies-of-empty", "M-BP-RX-16-dies-of-nothing",
    "M-VD-ROB-01-dies-of-type", "M-VD-ROB-01-dies-of-zero", "M-VD-ROB-01-dies-of-end", "M-VD-ROB-01-dies-of-text",
    # Nodes that stop receiving.
    "M-BP-RX-16-mute", "M-VD-ROB-01-mute",
    # Nodes that send malformed or too long beacons.
    "M-DATA-01-swapped-length", "M-BP-HDR-07-one", "M-BP-FMT-01-gap", "M-VD-TYP-05-member-order",
    # Nodes that store wrong values.
    "M-VD-RX-09-first-record", "M-VD-RX-09-backwards", "M-VD-RX-09-signed-count", "M-VD-RX-08-updates-first",
    "M-VD-RX-08-deletes-first", "M-VD-PC-07-seqno-zero", "M-VD-PC-07-nul-value", "M-VD-PC-01-same",
    "M-VD-PC-01-earlier", "M-VD-PC-01-later-refused", "M-VD-PC-01-low-half", "M-VD-PC-02-not-revived",
    "M-VD-PC-03-taken", "M-VD-PC-04-any-value", "M-VD-PC-05-empty-description", "M-VD-PC-06-zero", "M-VD-PD-03-own",
    "M-VD-PD-04-ignored", "M-VD-PU-02-revived", "M-VD-PU-03-own", "M-VD-PU-05-stored", "M-VD-PU-06-stored",
    "M-VD-PU-07-no-wrap", "M-VD-PU-07-number-kept", "M-VD-PU-07-newest-lost", "M-VD-PU-06-quarter",
    "M-VD-PS-04-number-taken", "M-VD-DB-02-forgets",
    # Nodes that send wrong records.
    "M-VD-CMP-06-one-more", "M-VD-PC-08-updateQ", "M-VD-PD-04-createQ", "M-VD-SCP-01-summary-copied",
    # Nodes that do not send required records.
    "M-VD-PS-03-not-taught", "M-VD-PS-04-not-requested", "M-VD-RU-01-ignored", "M-VD-RU-04-consumer-silent",
    "M-VD-RC-03-consumer-silent", "M-VD-DEL-05-silent", "M-VD-CRE-12-only-summarised",
    # Their services do what they must not.
    "M-VD-CRE-02-foreign", "M-VD-UPD-02-creates", "M-VD-UPD-03-foreign", "M-VD-UPD-07-wraps-early", "M-VD-DEL-02-ok",
    "M-VD-DEL-03-foreign", "M-VD-REA-03-deleted", "M-VD-REA-04-first-value",
)  # fmt: skip

#: Where the others are whose fault can show.
_LISTENING = ("M-BP-RX-", "M-VD-P", "M-VD-R", "M-VD-DB")


def campaign_on(mutant: Mutant, seconds: float, seed: int) -> dict[str, Any]:
    """One campaign; what it found first."""
    codec = Codec(mutant.profile)
    rng = random.Random(f"{seed}/0")
    mutator = Mutator(codec, rng, drawn_pool(codec, rng))
    target = stack_target(codec, mutant.id)
    sequences = Lifetimes(SweepFirst(Sequences(codec, rng, target.own_id, mutator), codec))
    saved = SavedTarget("stack", target.name, mutant.id)
    campaign = Campaign(codec, target, sequences, saved, seed, mutator=mutator, own_id=target.own_id)
    seen: list[float] = []
    begun = time.monotonic()
    run = target.run

    def timed(steps: Any) -> Any:
        effect = run(steps)
        if effect is not None and not seen:
            seen.append(time.monotonic() - begun)
        return effect

    target.run = timed  # type: ignore[method-assign]
    state = campaign.run(Limits(seconds=seconds, findings=1))
    found = campaign.artefacts[0] if campaign.artefacts else None
    return {
        "mutant": mutant.id,
        "what": mutant.what,
        "found": found is not None,
        "seconds": seen[0] if seen else None,
        "cases": state.cases,
        "frames": found.frames if found is not None else None,
        "steps": len(found.steps) if found is not None else None,
        "octets": found.octets if found is not None else None,
        "requirements": list(found.effect.requirements) if found is not None else [],
        "effect": found.effect.signature if found is not None else "",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mutants", nargs="*", metavar="MUTANT")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="every mutant of reception and of the database")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    known = all_mutants()
    names = options.mutants or ([name for name in known if name.startswith(_LISTENING)] if options.all else CHOSEN)
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"there is no mutant {', '.join(unknown)}")
    rows = []
    for name in names:
        row = campaign_on(known[name], options.seconds, options.seed)
        rows.append(row)
        if row["found"]:
            took = f"{row['seconds']:6.2f} s {row['cases']:6} cases {row['frames']:2} frames {row['octets']:4} octets"
            print(f"{name:38} {took}  {', '.join(row['requirements'])}: {row['effect'][:50]}")
        else:
            print(f"{name:38} not found in {row['cases']} cases: {row['what']}")
        sys.stdout.flush()
    found = [row for row in rows if row["found"]]
    small = sum(row["frames"] <= 3 for row in found)
    print(f"{len(found)} of {len(rows)} found, {small} of them shown in at most 3 frames")
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
