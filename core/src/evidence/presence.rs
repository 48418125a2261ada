//! How present a cell is: the fraction of the passes with it in view that hit it, lately.
//!
//! Hits alone only ever grow. What distinguishes a wall from a car that was parked there once, or a wall that
//! was torn down from one that stands, is how often it was *not* hit by those that looked. The mean
//! is exact for the first [`MEMORY`] passes; from then on each pass moves it by a `MEMORY`-th, so that
//! it follows the world.

/// Presence of a cell that every pass hit; the unit of the fixed point.
pub const ALWAYS: u16 = u16::MAX;
/// Passes that a presence remembers.
pub const MEMORY: u16 = 16;
/// Below this, and after [`MEMORY`] passes, a cell is dropped: what one pass saw fades after 22 others,
/// a wall that everyone saw after 65.
pub const FADED: u16 = ALWAYS / 64;

/// As a number from 0 to 1.
#[must_use]
pub fn fraction(presence: u16) -> f64 {
    f64::from(presence) / f64::from(ALWAYS)
}

/// After a pass that hit the cell; the pass is the `observed`-th that has it in view.
#[must_use]
pub fn hit(before: u16, observed: u16) -> u16 {
    before + part(ALWAYS - before, observed)
}

/// After a pass that did not hit it.
#[must_use]
pub fn missed(before: u16, observed: u16) -> u16 {
    before - part(before, observed)
}

/// After a hit by a pass that was taken for one that missed it, because an earlier upload of the same
/// pass had the cell in view already.
#[must_use]
pub fn made_up(before: u16, observed: u16) -> u16 {
    before.saturating_add(part(ALWAYS, observed))
}

/// Whether a cell is to be dropped.
#[must_use]
pub fn is_faded(presence: u16, observed: u16) -> bool {
    observed >= MEMORY && presence < FADED
}

/// What one pass's part of a value is, rounded.
fn part(value: u16, observed: u16) -> u16 {
    let passes = observed.clamp(1, MEMORY);
    ((u32::from(value) + u32::from(passes) / 2) / u32::from(passes)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_miss_made_up_for_is_a_hit(before: u16, observed in 1..100_u16) {
            let late = made_up(missed(before, observed), observed);
            prop_assert!(late.abs_diff(hit(before, observed)) <= 1);
        }

        /// Fails when a step is not the reciprocal of the number of passes.
        #[test]
        fn the_first_passes_make_an_exact_mean(hits in prop::collection::vec(any::<bool>(), 1..=16)) {
            let passes = (1..).zip(&hits);
            let found = passes.fold(0, |p, (n, is_hit)| if *is_hit { hit(p, n) } else { missed(p, n) });
            let expected = hits.iter().filter(|h| **h).count() as f64 / hits.len() as f64;
            prop_assert!((fraction(found) - expected).abs() < 2e-4, "{} {}", fraction(found), expected);
        }
    }

    #[test]
    fn the_docs_numbers_of_passes_until_a_cell_fades_are_right() {
        let passes = |from: u16| {
            let faded = |presence: &u16| !is_faded(*presence, MEMORY);
            std::iter::successors(Some(from), |p| Some(missed(*p, MEMORY))).take_while(faded).count()
        };
        assert_eq!([passes(ALWAYS / MEMORY), passes(ALWAYS)], [22, 65]);
    }
}
