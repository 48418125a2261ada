//! Records in order of time, whatever the order in which they stand.
//!
//! One record that is stamped wrongly must not take others with it: of all records, the most that stand in order are kept (the
//! longest increasing subsequence), and those between are skipped. A stretch of the log that stands as a whole where it does not
//! belong, as after a clock was set, is kept, too: it is moved to its time. A part in which hardly anything stands in order was
//! written in another order than that of time: it is sorted as a whole.

use super::{Flaws, Problem};

/// So many records in a row are a stretch of their own, and no slip.
const STRETCH: usize = 10;

/// Where no more than this of a part stands in order, it is sorted instead: numerator and denominator.
const FEW: (usize, usize) = (3, 4);

/// A few records that are farther than this from all others are stamped wrongly, microseconds.
const APART_US: i64 = 600_000_000;

/// The given items by increasing times; what is skipped is counted in `flaws` under `part`. Items are (time in microseconds,
/// place in the part, value).
pub(super) fn in_order<T>(items: Vec<(i64, u64, T)>, part: &str, flaws: &mut Flaws) -> Vec<(i64, u64, T)> {
    let ordered = if items.is_sorted_by(|a, b| a.0 < b.0) { items } else { put_in_order(items, part, flaws) };
    let times: Vec<i64> = ordered.iter().map(|item| item.0).collect();
    without_the_lonely(ordered, &times, |item, before_us| {
        flaws.skip(part, item.1, &Problem::OutOfOrder { time_us: item.0, before_us });
    })
}

/// Items, the times of which are in order, without a few that are far from all others; these are told, each with the time of another.
pub(super) fn without_the_lonely<T>(items: Vec<T>, times: &[i64], mut tell: impl FnMut(&T, i64)) -> Vec<T> {
    let runs: Vec<&[i64]> = times.chunk_by(|a, b| b.saturating_sub(*a) <= APART_US).collect();
    let longest = runs.iter().max_by_key(|run| run.len()).filter(|run| run.len() >= STRETCH);
    let (Some(longest), true) = (longest, runs.len() > 1) else { return items };
    let other_us = longest[0];
    let stay = runs.iter().flat_map(|run| std::iter::repeat_n(run.len() >= STRETCH, run.len()));
    let kept = items.into_iter().zip(stay).filter_map(|(item, stays)| {
        if !stays {
            tell(&item, other_us);
        }
        stays.then_some(item)
    });
    kept.collect()
}

/// Records that stand at another place than in time are moved there, or skipped.
fn put_in_order<T>(items: Vec<(i64, u64, T)>, part: &str, flaws: &mut Flaws) -> Vec<(i64, u64, T)> {
    let times: Vec<i64> = items.iter().map(|item| item.0).collect();
    let mut kept = longest_increasing(&times);
    let moved = move_stretches(&times, &mut kept);
    let in_order = kept.iter().filter(|kept| **kept).count();
    if items.len() > STRETCH && in_order * FEW.1 <= items.len() * FEW.0 {
        return sorted(items, part, flaws);
    }
    if moved > 0 {
        flaws.note(format!(
            "{part}: {moved} records stand in the file at another place than in time; put in order"
        ));
    }
    let mut kept_times: Vec<i64> =
        times.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(t, _)| *t).collect();
    kept_times.sort_unstable();
    let mut before_us = times[0];
    let mut taken = Vec::with_capacity(kept_times.len());
    for ((time_us, place, value), kept) in items.into_iter().zip(kept) {
        if kept {
            before_us = time_us;
            taken.push((time_us, place, value));
        } else if kept_times.binary_search(&time_us).is_ok() {
            flaws.skip(part, place, &Problem::Doubled);
        } else {
            flaws.skip(part, place, &Problem::OutOfOrder { time_us, before_us });
        }
    }
    taken.sort_by_key(|(time_us, ..)| *time_us);
    taken
}

/// All items by increasing times; of equal times the first counts.
fn sorted<T>(mut items: Vec<(i64, u64, T)>, part: &str, flaws: &mut Flaws) -> Vec<(i64, u64, T)> {
    if !items.is_sorted_by_key(|item| item.0) {
        flaws.note(format!(
            "{part}: its {} records stand in another order than that of time; sorted",
            items.len()
        ));
    }
    items.sort_by_key(|(time_us, place, _)| (*time_us, *place));
    let mut taken: Vec<(i64, u64, T)> = Vec::with_capacity(items.len());
    for item in items {
        if taken.last().is_some_and(|before| before.0 == item.0) {
            flaws.skip(part, item.1, &Problem::Doubled);
        } else {
            taken.push(item);
        }
    }
    taken
}

/// Which of the times belong to a longest strictly increasing subsequence; of equal times the first does.
pub(super) fn longest_increasing<T: Ord>(times: &[T]) -> Vec<bool> {
    // By patience sorting: `ends[k]` is the index at which the best subsequence of length k + 1 ends.
    let mut ends: Vec<usize> = Vec::new();
    let mut previous: Vec<Option<usize>> = Vec::with_capacity(times.len());
    for (i, time) in times.iter().enumerate() {
        let at = ends.partition_point(|end| times[*end] < *time);
        previous.push(at.checked_sub(1).map(|before| ends[before]));
        match ends.get(at) {
            None => ends.push(i),
            Some(end) if times[*end] > *time => ends[at] = i,
            Some(_) => {}
        }
    }
    let mut kept = vec![false; times.len()];
    let mut at = ends.last().copied();
    while let Some(i) = at {
        kept[i] = true;
        at = previous[i];
    }
    kept
}

/// Keeps stretches that increase in themselves and lie in a gap of what is kept; returns how many records they have.
fn move_stretches(times: &[i64], kept: &mut [bool]) -> usize {
    let mut moved = 0;
    let mut from = 0;
    let mut taken: Vec<i64> = times.iter().zip(&*kept).filter(|(_, kept)| **kept).map(|(t, _)| *t).collect();
    while from < times.len() {
        if kept[from] {
            from += 1;
            continue;
        }
        let mut to = from + 1;
        while to < times.len() && !kept[to] && times[to] > times[to - 1] {
            to += 1;
        }
        let stretch = &times[from..to];
        let at = taken.partition_point(|time| *time < stretch[0]);
        let alone = taken.get(at).is_none_or(|next| *next > stretch[stretch.len() - 1]);
        if stretch.len() >= STRETCH && alone {
            kept[from..to].fill(true);
            taken.splice(at..at, stretch.iter().copied());
            moved += stretch.len();
        }
        from = to;
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ordered(times: &[i64]) -> (Vec<i64>, Flaws) {
        let mut flaws = Flaws::default();
        let items = times.iter().zip(1..).map(|(time, place)| (*time, place, *time)).collect();
        let kept = in_order(items, "odometry.csv", &mut flaws);
        assert!(kept.iter().all(|(time, _, value)| time == value));
        (kept.into_iter().map(|(time, ..)| time).collect(), flaws)
    }

    /// Catches: a record that is blamed for another's stamp, or takes others with it.
    #[test]
    fn the_record_that_is_wrong_is_skipped_and_no_other() {
        let day = 86_400_000_000;
        for wrong in [99, -99, day, -day] {
            let mut times: Vec<i64> = (0..20).map(|i| 10 * i).collect();
            times[7] += wrong;
            let (kept, flaws) = ordered(&times);
            assert_eq!(kept.len(), 19, "{wrong}: {kept:?}");
            assert_eq!((flaws.skipped.len(), flaws.skipped[0].first, flaws.total()), (1, 8, 1), "{flaws}");
        }
        let (kept, flaws) = ordered(&[1, 2, 2, 3, 5, 4, 6]);
        assert_eq!(kept.len(), 5);
        assert_eq!((flaws.count("doubled"), flaws.count("out_of_order")), (1, 1), "{flaws}");
    }

    /// Catches: a clock that is set in the middle of a drive, and takes half of it.
    #[test]
    fn a_stretch_at_another_time_is_moved_there() {
        let times: Vec<i64> = (1000..1030).chain(0..20).collect();
        let (kept, flaws) = ordered(&times);
        assert_eq!(kept, (0..20).chain(1000..1030).collect::<Vec<_>>());
        assert!(flaws.total() == 0 && flaws.to_string().contains("20 records"), "{flaws}");
    }

    /// Catches: a first or last record that is stamped wrongly, stands in order all the same, and is kept.
    #[test]
    fn a_few_far_from_all_others_are_skipped_and_told() {
        let hour = 3_600_000_000;
        for lonely in
            [&[-hour][..], &[hour], &[400 * 24 * hour, 400 * 24 * hour + 1], &[-hour, hour], &[i64::MAX]]
        {
            let mut times: Vec<i64> = (0..50).collect();
            times.extend(lonely);
            times.sort_unstable();
            let (kept, flaws) = ordered(&times);
            assert_eq!(kept, (0..50).collect::<Vec<_>>());
            assert_eq!(
                (flaws.count("out_of_order"), flaws.total()),
                (lonely.len() as u64, lonely.len() as u64),
                "{flaws}"
            );
        }
        // A drive with a break, and one that is short, stay whole.
        let pause: Vec<i64> = (0..50).chain(hour..hour + 10).collect();
        assert_eq!(ordered(&pause).0, pause);
        assert_eq!(ordered(&[0, hour]).0, [0, hour]);
    }

    /// Catches: a log that a recorder of several threads wrote, or that was read from its end, of which half is thrown away.
    #[test]
    fn a_part_in_another_order_is_sorted() {
        let sorted: Vec<i64> = (0..100).collect();
        let swapped: Vec<i64> = (0..100).map(|i| i ^ 1).collect();
        let backwards: Vec<i64> = (0..100).rev().collect();
        for times in [swapped, backwards] {
            let (kept, flaws) = ordered(&times);
            assert_eq!(kept, sorted);
            assert!(
                flaws.total() == 0 && flaws.to_string().contains("100 records stand in another order"),
                "{flaws}"
            );
        }
        let twice: Vec<i64> = (0..100).map(|i| i / 2).collect();
        let (kept, flaws) = ordered(&twice);
        assert_eq!((kept.len(), flaws.count("doubled"), flaws.notes.len()), (50, 50, 0), "{flaws}");
    }

    proptest! {
        /// Catches: a record that is lost without a word, or kept twice, and times that do not increase.
        #[test]
        fn every_record_is_kept_or_told(times in proptest::collection::vec(0_i64..40, 1..60)) {
            let (kept, flaws) = ordered(&times);
            prop_assert!(kept.is_sorted_by(|a, b| a < b));
            prop_assert_eq!(kept.len() as u64 + flaws.total(), times.len() as u64);
        }
    }
}
