"""Which one is wrong: simple errors here, warped real runs in benchmarks/doubtful_truth.py."""

from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.comparison.doubts import sentence
from vio_eval_ros.comparison.hat import own_errors, TRUTH, which_is_wrong

ROOT = Path(__file__).resolve().parents[2]
STAMPS = np.arange(300) * 100_000_000
ALONG = np.linspace(0, 1, 300)[:, None]
PATH = 5 * np.hstack([np.sin(7 * ALONG), np.cos(5 * ALONG), 0.3 * np.sin(9 * ALONG)])


def systems(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Return systems with smooth errors of their own, a centimetre or so."""
    source = np.random.default_rng(seed)
    phases, ways = source.uniform(0, 6, (count, 8, 1, 1)), source.normal(size=(count, 8, 1, 3))
    waves = np.sin(np.arange(3, 19, 2)[:, None, None] * ALONG + phases) * ways
    return {f'S{k}': PATH + 0.005 * waves[k].sum(axis=0) for k in range(count)}


def bump(size_m: float) -> np.ndarray:
    """Return what is off from 9 s to 15 s."""
    return np.sin(np.pi * np.clip((ALONG - 0.3) / 0.2, 0, 1)) ** 2 * [size_m, 0, 0]


def test_the_hat_gives_the_own_error_of_each():
    source = np.random.default_rng(0)
    own = np.array([0.0, 0.1, 0.2, 0.3])
    parties = own[:, None, None] * source.normal(size=(4, 5000, 3)) / np.sqrt(3)
    np.testing.assert_allclose(own_errors(parties), own, atol=0.01)


@pytest.mark.parametrize('seed', range(10))
def test_a_right_truth_is_not_named(seed):
    assert which_is_wrong(STAMPS, PATH, systems(4, seed)).wrong != (TRUTH,)


def test_none_is_named_where_all_are_alike():
    noise = np.random.default_rng(0).normal(size=(4, 300, 3))
    found = which_is_wrong(STAMPS, PATH, {f'S{k}': PATH + noise[k] for k in range(4)})
    assert (found.verdict, found.wrong) == ('no party is wrong', ())


def test_a_truth_is_named_with_where():
    found = which_is_wrong(STAMPS, PATH + bump(0.2), systems(4))
    assert found.wrong == (TRUTH,)
    assert 7 < found.begin_s < 12
    assert 13 < found.end_s < 19
    assert 0.08 < found.error_m < 0.2
    assert 'the ground truth is doubtful from' in sentence(found)


def test_the_system_is_named_that_is_alone():
    found = systems(4)
    found['S2'] += bump(0.2)
    assert which_is_wrong(STAMPS, PATH, found).wrong == ('S2',)


def test_an_alignment_changes_nothing():
    found = systems(4)
    before = which_is_wrong(STAMPS, PATH, found)
    found['S1'] = found['S1'] + np.cross([0, 0, 0.1], PATH) + 1.0
    after = which_is_wrong(STAMPS, PATH, found)
    assert after.wrong == before.wrong
    assert after.own_errors == pytest.approx(before.own_errors, abs=1e-9)


def test_systems_that_share_their_errors_cannot_tell():
    found = systems(2)
    found['again'] = found['S1'] + 0.1 * (systems(3)['S2'] - PATH)
    doubt = which_is_wrong(STAMPS, PATH + bump(0.2), found)
    assert doubt.verdict == 'cannot tell'
    assert doubt.why == 'S1 and again share their errors, 3 families may tell'


@pytest.mark.parametrize(
    ('count', 'stamps', 'why'),
    [
        (2, 300, '2 systems are too few, 3 may tell'),
        (3, 20, 'all systems share 20 poses, 60 may tell'),
    ],
)
def test_too_little_cannot_tell(count, stamps, why):
    found = {name: each[:stamps] for name, each in systems(count).items()}
    assert which_is_wrong(STAMPS[:stamps], PATH[:stamps], found).why == why


@pytest.mark.slow
def test_warped_truths_and_systems_are_named(shared_data, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / 'benchmarks'))
    import doubtful_truth

    for sequence, group in doubtful_truth.groups(tmp_path):
        assert group.doubt().wrong != (TRUTH,)
        if sequence != 'MH_01':  # two systems there are the same one
            rates = [doubtful_truth.named(group, kind, 5)[:2] for kind in doubtful_truth.WARPS]
            truth, system = np.mean(rates, axis=0)
            assert truth >= doubtful_truth.TRUTH_GOAL
            assert system >= doubtful_truth.SYSTEM_GOAL
