"""The rules by which the book judges the paper's claims."""

import ast
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import paper_verdicts
from paper_claims import BAR, CLAIMS, RETURNS, SUCCESSES, Comparison
from paper_verdicts import (
    CONFIRMED,
    CONFOUNDED,
    CONTRADICTED,
    COULD_NOT_FAIL,
    IN_PART,
    SEEDS,
    STEPS,
    UNDECIDED,
    UNTESTED,
    WORDS,
    at_plateau,
    compare,
    could_fail,
    joined,
    large_enough,
    seen,
    support,
    verdict,
)
from paper_words import number

ROOT = Path(__file__).parents[2]


def test_a_number_has_a_proper_minus_and_zero_none():
    assert [number(-12345.6), number(-0.04, 1), number(1 / 3, 2)] == ["−12,346", "0.0", "0.33"]


def curves(to_go, steps=40, hot=()):
    """Something like a record: ten noisy curves that end near 10; each has so far to go.

    The temperature of seeds that are hot has run away.
    """
    rng, left = np.random.default_rng(0), np.linspace(1, 0, 40)
    noise = rng.normal(scale=0.3, size=(10, 40))
    returns = 10 + noise - np.multiply.outer(to_go, left)
    rows = [
        SimpleNamespace(seed=seed, metrics={"temperature": 1001 if seed in hot else 1000})
        for seed in range(10)
    ]
    taken = np.arange(1, 41) * steps // 40
    return SimpleNamespace(steps=taken, returns=returns, seeds=tuple(range(10)), rows=rows)


def test_an_interval_speaks_for_a_claim_or_against_it():
    assert support("better", 1, 3) == (1, 3)
    assert support("fails", 1, 3) == (-3, -1)
    assert support("comparable", -1, 2, margin=5) == (3, 5)
    assert support("comparable", 6, 9, margin=5) == (-4, -1)
    assert support("comparable", -4, 3, margin=2) == (-2, 2)
    assert [seen(1, 2), seen(-2, -1), seen(-1, 2), seen(0, 1)] == [
        "as claimed",
        "the opposite",
        "unclear",
        "unclear",
    ]


def test_chapter_11_shows_what_its_command_prints():
    cells = json.loads((ROOT / "book/11_results.ipynb").read_text("utf-8"))["cells"]
    (text,) = (s for s in ("".join(c["source"]) for c in cells) if "p.decided()" in s)
    printed = re.search(r"```text\n(\{.*?\})\n```", text, re.DOTALL)
    assert ast.literal_eval(printed[1]) == paper_verdicts.decided()[1]


def test_a_comparison_gets_a_verdict_only_if_its_records_are_large_enough():
    assert verdict("as claimed", True) == CONFIRMED
    assert verdict("the opposite", True) == CONTRADICTED
    assert verdict("unclear", True) == UNDECIDED
    for told in ("as claimed", "the opposite", "unclear"):
        assert verdict(told, False) == verdict(told, False, confounded=True) == UNTESTED
    assert verdict("as claimed", True, confounded=True) == CONFOUNDED
    assert verdict("unclear", True, confounded=True) == UNDECIDED


def test_a_claim_is_confirmed_if_all_of_its_comparisons_are():
    assert joined([CONFIRMED, CONFIRMED]) == CONFIRMED
    assert joined([CONFIRMED, UNDECIDED]) == joined([CONFOUNDED, CONFIRMED]) == IN_PART
    assert joined([CONFIRMED, UNTESTED]) == UNTESTED
    assert joined([CONFIRMED, UNTESTED, CONTRADICTED]) == CONTRADICTED
    assert joined([UNDECIDED, CONFOUNDED]) == CONFOUNDED
    assert joined([UNDECIDED, UNDECIDED]) == UNDECIDED
    assert joined([CONFIRMED, CONFIRMED], can_fail=False) == COULD_NOT_FAIL
    assert joined([CONFIRMED, UNDECIDED], can_fail=False) == IN_PART
    of_several = {IN_PART, COULD_NOT_FAIL}
    assert {joined([word]) for word in {*WORDS} - of_several} == {*WORDS} - of_several


def test_only_the_claim_about_the_wall_could_not_fail():
    """Nobody had arrived before, so nothing could have contradicted it."""
    free = {n for n in CLAIMS if not any(map(could_fail, CLAIMS[n].comparisons))}
    assert free == {4}


def test_a_claim_that_seeds_arrive_can_fail_if_many_had_arrived_before(monkeypatch):
    monkeypatch.setattr(paper_verdicts, "largest", lambda run: "full")
    for question, first, can in (("arrives", 8, True), ("arrives", 3, False), ("varies", 8, False)):
        found = ending(first=first)
        monkeypatch.setattr(paper_verdicts, "recorded", lambda run, size, found=found: found)
        assert could_fail(Comparison("", question, "run")) == can


def test_a_curve_that_still_moves_is_at_no_plateau():
    assert at_plateau(curves(np.zeros(10)), 40)
    assert not at_plateau(curves(np.full(10, 9.0)), 40)
    # An interquartile mean would not see the two that have not arrived.
    assert not at_plateau(curves(np.repeat([40.0, 0.0], [2, 8])), 40)
    assert not at_plateau(curves(np.zeros(10)), 4), "too few evaluations to say"


def test_records_are_large_enough_at_a_plateau_or_after_the_papers_steps():
    still, moving = curves(np.zeros(10)), curves(np.full(10, 9.0))
    assert large_enough([still, still], "full")
    assert not large_enough([still, moving], "full")
    assert large_enough([curves(np.full(10, 9.0), steps=STEPS)], "full")
    assert not large_enough([still], "demo")
    still.returns[0, 3] = np.nan
    assert not large_enough([still], "full"), f"fewer than {SEEDS} seeds"


def ending(*above, first=0, **kwargs):
    """A record of ten seeds, of which these end above the bar, and the first few begin there."""
    found = curves(np.zeros(10), **kwargs)
    found.returns = np.full((10, 40), BAR - 10.0)
    found.returns[list(above), 1:] = BAR + 5
    found.returns[:first, 0] = BAR + 5
    return found


@pytest.fixture
def told(monkeypatch):
    """What is told of a question about records that are given."""
    monkeypatch.setattr(paper_verdicts, "networks", lambda run, size: "paper-size networks")

    def ask(question, *found):
        runs = {f"run/{i}": each for i, each in enumerate(found)}
        monkeypatch.setattr(paper_verdicts, "recorded", lambda run, size: runs[run])
        other = "run/1" if len(found) > 1 else None
        answer = compare(Comparison("", question, "run/0", other), sizes=("full",))
        return answer.seen, answer.verdict

    return ask


def test_a_transfer_works_if_more_seeds_arrive_than_before_it(told):
    assert told("arrives", ending(*range(8))) == ("as claimed", CONFIRMED)
    assert told("arrives", ending(*range(5))) == ("unclear", UNDECIDED)
    assert told("arrives", ending(*range(8), first=8)) == ("unclear", UNDECIDED)
    assert told("arrives", ending(first=8)) == ("the opposite", CONTRADICTED)


def test_no_number_of_arrivals_contradicts_the_claim_about_the_wall(told):
    """If nobody has arrived before: six to nine of ten confirm it, the others do in part or not."""
    assert [each.question for each in CLAIMS[4].comparisons] == ["arrives", "varies"]
    verdicts = [
        joined([told(question, ending(*range(n)))[1] for question in ("arrives", "varies")])
        for n in range(11)
    ]
    assert verdicts == [UNDECIDED] + [IN_PART] * 5 + [CONFIRMED] * 4 + [IN_PART]


def test_a_transfer_varies_if_some_seeds_arrive_and_some_do_not(told):
    assert told("varies", ending(1))[0] == "as claimed"
    assert told("varies", ending())[0] == told("varies", ending(*range(10)))[0] == "unclear"


def test_what_mostly_fails_has_its_interval_below_one_half(told):
    assert told("mostly fails", ending(3)) == ("as claimed", CONFIRMED)
    assert told("mostly fails", ending(1, 2, 3, 4))[0] == "unclear"
    assert told("mostly fails", ending(*range(9)))[0] == "the opposite"


def test_a_temperature_that_ran_away_confounds_what_its_seeds_could_turn(told):
    assert told("mostly fails", ending(hot=[3])) == ("as claimed", CONFIRMED)
    assert told("mostly fails", ending(hot=range(5))) == ("as claimed", CONFOUNDED)
    assert told("mostly fails", ending(*range(9), hot=[3])) == ("the opposite", CONFOUNDED)
    assert told("mostly fails", ending(*range(9), hot=[9])) == ("the opposite", CONTRADICTED)
    assert told("mostly fails", ending(1, 2, 3, 4, hot=[3])) == ("unclear", UNDECIDED)
    assert told("varies", ending(*range(9), hot=[9])) == ("as claimed", CONFOUNDED)
    assert told("varies", ending(*range(8), hot=[9])) == ("as claimed", CONFIRMED)
    all_arrive, six = ending(*range(10)), ending(*range(6))
    assert told("more arrive", six, ending()) == ("as claimed", CONFIRMED)
    for seed in (3, 9):
        assert told("more arrive", six, ending(hot=[seed])) == ("as claimed", CONFOUNDED)
    assert told("more arrive", all_arrive, ending(hot=[3])) == ("as claimed", CONFIRMED)
    better = ending(*range(6), hot=[3])
    assert told("more arrive", better, ending()) == ("as claimed", CONFOUNDED)


def test_runs_are_compared_at_the_last_step_that_both_have(told):
    late = ending(*range(10), steps=80)
    late.returns[:, :-2] = BAR - 10  # arrived, but after the other has ended
    late.rows, early = [], ending(steps=40)
    assert told("more arrive", late, early)[0] == "unclear"


def test_a_seed_that_was_given_up_has_no_pair(told):
    one, other = ending(*range(10)), ending()
    one.returns[:5, -1] = np.nan
    assert told("more arrive", one, other) == ("unclear", UNTESTED)


def test_claims_ask_questions_that_there_are():
    asked = [each for claim in CLAIMS.values() for each in (*claim.comparisons, *claim.instead)]
    assert {each.question for each in asked} == {*RETURNS, *SUCCESSES}
    assert [*CLAIMS] == [*range(1, 9)]
    success = {n for n, claim in CLAIMS.items() if claim.comparisons[0].question in SUCCESSES}
    assert success == {4, 6, 7, 8}
