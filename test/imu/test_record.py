"""A record comes out the same, however disorderly it came in."""

import tracemalloc

import numpy as np
import pytest

from vio_eval_ros.errors import ReadError
from vio_eval_ros.imu import record
from vio_eval_ros.imu.record import Record

PERIOD_NS = 5_000_000
FIRST_NS = 1_403_636_579_763_555_584


def made(count=3_000, seed=1):
    """Return stamps and samples, each row its own."""
    stamps_ns = FIRST_NS + PERIOD_NS * np.arange(count)
    return stamps_ns, np.random.default_rng(seed).standard_normal((count, 6))


def taken(stamps_ns, samples, block=250, **options):
    taker = Record('test', **options)
    for begin in range(0, len(stamps_ns), block):
        taker.add(stamps_ns[begin : begin + block], samples[begin : begin + block])
    return taker.finish()


def joined(signal):
    """Return each segment as (n, 6)."""
    return [
        np.stack(axes, axis=1) for axes in zip(*(signal.axis(i) for i in range(6)), strict=True)
    ]


@pytest.fixture
def small_window(monkeypatch):
    """Let samples be taken over while more are coming, as in a record of hours."""
    monkeypatch.setattr(record, 'SORTED_SAMPLES', 400)


@pytest.mark.parametrize('block', [1, 7, 250, 3_000])
def test_an_orderly_record_stays_as_it_is(small_window, block):
    stamps_ns, samples = made()
    signal = taken(stamps_ns, samples, block)
    np.testing.assert_array_equal(*joined(signal), samples)
    assert signal.rate_hz == pytest.approx(200.0, rel=1e-12)
    assert signal.first_ns == FIRST_NS
    assert signal.duration_s == pytest.approx(15.0)
    counts = vars(signal.counts)
    assert counts.pop('samples') == 3_000
    assert not any(counts.values())


def test_samples_out_of_order_are_sorted_and_counted(small_window):
    stamps_ns, samples = made()
    order = np.arange(3_000)
    order[100:102] = 101, 100
    order[2_000:2_300] = np.roll(order[2_000:2_300], 17)
    signal = taken(stamps_ns[order], samples[order])
    np.testing.assert_array_equal(*joined(signal), samples)
    assert signal.counts.unsorted == 1 + 283
    assert not signal.counts.late


def test_what_comes_too_late_to_be_sorted_is_left_out_and_counted(small_window):
    stamps_ns, samples = made()
    order = np.concatenate([np.arange(1, 3_000), [0]])
    signal = taken(stamps_ns[order], samples[order])
    assert signal.counts.late == 1
    np.testing.assert_array_equal(*joined(signal), samples[1:])


def test_repeats_are_left_out_but_other_values_at_the_same_stamp_are_not(small_window):
    stamps_ns, samples = made()
    again = np.sort(np.concatenate([np.arange(3_000), [50, 50, 2_700]]))
    stamps_ns[1_501] = stamps_ns[1_500]
    signal = taken(stamps_ns[again], samples[again])
    assert signal.counts.repeated == 3
    assert signal.counts.equal_stamps == 1
    np.testing.assert_array_equal(*joined(signal), samples)


def test_a_few_lost_samples_are_passed_over_and_counted(small_window):
    stamps_ns, samples = made()
    kept = np.delete(np.arange(3_000), [70, 1_000, 1_001, 1_002, 2_500])
    (found,) = joined(signal := taken(stamps_ns[kept], samples[kept]))
    assert (signal.counts.missing, signal.counts.gaps) == (5, 0)
    np.testing.assert_array_equal(found, samples[kept])
    assert signal.missing == pytest.approx(5 / 3_000)
    assert signal.rate_hz == pytest.approx(200.0, rel=1e-12)
    assert signal.duration_s == pytest.approx(15.0)


def test_times_are_those_of_the_stamps_whatever_is_lost(small_window):
    stamps_ns, samples = made()
    stamps_ns[2_000:] += 60 * 10**9
    kept = np.delete(np.arange(3_000), np.arange(10, 2_000, 5))
    signal = taken(stamps_ns[kept], samples[kept])
    assert [segment.length for segment in signal.segments] == [1_602, 1_000]
    times_s = signal.times_s(160)
    np.testing.assert_allclose(times_s[:10], np.arange(10), atol=0.02)
    np.testing.assert_allclose(times_s[10:], 70 + 0.8 * np.arange(6), atol=0.02)


@pytest.mark.parametrize('begin', [1_000, 399, 400, 401, 2_980])
def test_a_long_gap_cuts_the_record(small_window, begin):
    stamps_ns, samples = made()
    stamps_ns[begin:] += 500 * PERIOD_NS
    signal = taken(stamps_ns, samples)
    assert (signal.counts.gaps, signal.counts.lost) == (1, 500)
    before, after = joined(signal)
    np.testing.assert_array_equal(before, samples[:begin])
    np.testing.assert_array_equal(after, samples[begin:])
    assert signal.rate_hz == pytest.approx(200.0, rel=1e-12)


@pytest.mark.parametrize('size_ns', [2_000_000, 4_000_000])
def test_jitter_is_no_loss(small_window, size_ns):
    stamps_ns, samples = made()
    jitter = np.random.default_rng(2).integers(0, size_ns, 3_000)
    signal = taken(stamps_ns + jitter, samples)
    assert not signal.counts.missing
    assert not signal.counts.gaps
    np.testing.assert_array_equal(*joined(signal), samples)
    assert signal.rate_hz == pytest.approx(200.0, rel=1e-3)


def test_bursts_are_no_loss_and_a_loss_among_them_is_one(small_window):
    """Some drivers stamp all samples of a transfer with its arrival."""
    stamps_ns, samples = made()
    bursts_ns = FIRST_NS + (stamps_ns - FIRST_NS) // (8 * PERIOD_NS) * 8 * PERIOD_NS
    signal = taken(bursts_ns, samples)
    assert (signal.counts.missing, signal.counts.gaps) == (0, 0)
    assert signal.counts.equal_stamps == 3_000 * 7 // 8
    assert signal.rate_hz == pytest.approx(200.0, rel=0.01)
    kept = np.delete(np.arange(3_000), np.arange(1_600, 1_800))
    signal = taken(bursts_ns[kept], samples[kept])
    assert signal.counts.gaps == 1
    assert abs(signal.counts.lost - 200) <= 1


def test_stamps_rounded_to_milliseconds_are_no_loss(small_window):
    stamps_ns = np.arange(3_000) * 7_812_500 // 1_000_000 * 1_000_000
    signal = taken(stamps_ns, made()[1])
    assert (signal.counts.missing, signal.counts.gaps) == (0, 0)
    assert signal.rate_hz == pytest.approx(128.0, rel=1e-3)


def test_a_drifting_clock_is_no_loss(small_window):
    stamps_ns = FIRST_NS + np.rint(np.arange(200_000) * PERIOD_NS * 1.0005).astype(int)
    signal = taken(stamps_ns, np.ones((200_000, 6)), 5_000)
    assert (signal.counts.missing, signal.counts.gaps) == (0, 0)
    assert signal.rate_hz == pytest.approx(200 / 1.0005, rel=1e-7)


def test_ten_percent_of_losses_are_all_found(small_window):
    stamps_ns, samples = made(20_000)
    kept = np.sort(np.random.default_rng(1).permutation(20_000)[:18_000])
    signal = taken(stamps_ns[kept], samples[kept])
    missing = kept[-1] - kept[0] + 1 - 18_000
    assert signal.counts.missing == missing
    assert signal.rate_hz == pytest.approx(200.0, rel=1e-6)


def test_what_is_not_finite_is_left_out_and_counted(small_window):
    stamps_ns, samples = made()
    samples[10, 3], samples[1_500, 0], samples[2_000, 5] = np.nan, np.inf, 1e300
    signal = taken(stamps_ns, samples)
    assert signal.counts.not_finite == 3
    assert signal.counts.missing == 3
    with pytest.raises(ReadError, match=r'fewer than 10 .*left out: 3,000 NaN, infinite or above'):
        taken(stamps_ns, np.full((3_000, 6), 1e300))


def test_beyond_the_capacity_neighbours_are_averaged(small_window):
    stamps_ns, samples = made(9_001)
    signal = taken(stamps_ns, samples, capacity=2_500)
    assert signal.averaged == 4
    (found,) = joined(signal)
    np.testing.assert_allclose(found, samples[:9_000].reshape(-1, 4, 6).mean(axis=1), atol=1e-12)
    assert signal.rate_hz == pytest.approx(50.0, rel=1e-12)
    assert signal.counts.cut == 1


def test_averaging_does_not_mix_what_a_gap_separates(small_window):
    stamps_ns, samples = made(9_000)
    samples[:4_001], samples[4_001:] = 1.0, 2.0
    stamps_ns[4_001:] += 10**10
    before, after = joined(taken(stamps_ns, samples, capacity=2_500))
    assert (before == 1).all()
    assert (after == 2).all()
    assert 2_240 <= len(before) + len(after) <= 2_250


def test_memory_does_not_grow_with_the_record(small_window):
    block = made(2_000)[1]

    def peak(blocks):
        taker = Record('test', capacity=5_000)
        tracemalloc.start()
        for number in range(blocks):
            begin = number * len(block)
            taker.add(FIRST_NS + PERIOD_NS * np.arange(begin, begin + len(block)), block)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(5)
    assert peak(200) < 1.2 * peak(20)


def test_stamps_that_advance_in_one_leap_only_are_an_error(small_window):
    stamps_ns = np.arange(3_000) // 100
    stamps_ns[-1] = 4 * 10**9
    with pytest.raises(ReadError, match='do not advance'):
        taken(stamps_ns, made()[1])


def test_stamps_that_stand_still_are_an_error():
    with pytest.raises(ReadError, match='do not advance'):
        taken(np.zeros(100, np.int64), made(100)[1])


def test_a_single_sample_is_an_error():
    with pytest.raises(ReadError, match='fewer than 10 samples'):
        taken(*made(1))
