"""A little of what `scripts/stress/fuzz.py` types, every time."""

import pytest

from scripts.stress.fuzz import answer_to, command, options


@pytest.mark.parametrize("is_lived", [False, True])
def test_random_commands_work_or_are_refused_in_one_sentence(is_lived: bool) -> None:
    for number in range(15 if is_lived else 60):
        words = command(3, number, is_lived)
        answer = answer_to(words, is_lived, seconds=120)
        assert not answer.is_failure, (words, answer)


def test_the_options_that_are_tried_are_those_of_the_help() -> None:
    known = options(("--experts", "mlp", "--drive", "curriculum"))
    assert known["experts.hidden"] == "[INT ...]"
    assert known["drive.stages.0.until"] == "INT"
    assert known["world"] == "TEXT"
    assert known["mp"] == ""
