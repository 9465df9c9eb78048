"""The sentence in a parser's box."""

import re
import sys

import pytest

from torch_iac.cli.parser_errors import plain_refusals, sentence_in

BOX = """\
╭─ Unrecognized options ────────────────╮
│ Unrecognized options: --step,         │
│ 3                                     │
│ ───────────────────────────────────── │
│ Perhaps you meant:                    │
│     --steps INT                       │
│         How many decisions.           │
│ ───────────────────────────────────── │
│ For full helptext, run torch-iac      │
│ train --help                          │
╰───────────────────────────────────────╯
"""


SENTENCE = "Unrecognized options: --step, 3; perhaps you meant --steps (see torch-iac train --help)"


@pytest.mark.parametrize("kind", ["utf-8", "ascii", "coloured"])
def test_the_sentence_says_what_is_wrong_what_is_there_and_where_to_look(kind: str) -> None:
    box = BOX
    if kind == "ascii":
        title, *lines, _ = (re.sub("[│╭╮╰╯]", " ", line) for line in BOX.splitlines())
        lines = [title.replace("─", " "), " " + "-" * 38, *lines]
        box = "\n".join(line.replace("─", "-") for line in lines)
    if kind == "coloured":
        box = BOX.replace("│", "\x1b[31m│\x1b[0m").replace("--step,", "\x1b[1m--step,\x1b[0m")
    assert sentence_in(box) == SENTENCE


@plain_refusals()
def refuse() -> None:
    sys.stderr.write(BOX)
    sys.exit(2)


def test_a_refusal_is_an_error_of_one_line() -> None:
    with pytest.raises(ValueError, match=re.escape(SENTENCE)):
        refuse()


def test_help_and_warnings_pass(capsys: pytest.CaptureFixture[str]) -> None:
    with plain_refusals():
        sys.stderr.write("mind the gap")
    assert capsys.readouterr().err == "mind the gap"
    with pytest.raises(SystemExit), plain_refusals():
        sys.exit(0)
