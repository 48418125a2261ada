//! Which places are worth another upload.
//!
//! The hundredth pass over a street tells little that the tenth did not. A place is well known once enough passes have seen it and
//! the newest is not old; what can still change there is seen by a pass now and then.

use crate::tile::Tile;

/// When a place is known well enough for some time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DemandPolicy {
    /// Passes over the cell of a typical hit that are enough; 0 for none, which wants every upload.
    pub enough_passes: u16,
    /// Days after the newest of them from which on another one is wanted.
    pub refresh_days: u16,
}

impl Default for DemandPolicy {
    fn default() -> Self {
        Self { enough_passes: 10, refresh_days: 14 }
    }
}

impl DemandPolicy {
    /// The UTC day, counted from the Unix epoch, from which on an upload of a place is wanted; 0 for any day. `tile` is
    /// what is served of it.
    #[must_use]
    pub fn wanted_from(&self, tile: Option<&Tile>) -> u16 {
        let Some(tile) = tile.filter(|tile| !tile.is_empty()) else { return 0 };
        let enough = self.enough_passes > 0 && tile.mean_passes() >= f64::from(self.enough_passes);
        if enough { tile.newest_day().saturating_add(self.refresh_days) } else { 0 }
    }
}

/// The day on which one of many vehicles is to come again, of which all were told on the day `today` that they are wanted from
/// a day on: they spread themselves, by a hash of each that stays the same, over as many days more as they were told to wait.
#[must_use]
pub fn turn_of(hash: u32, wanted_from: u16, today: u16) -> u16 {
    let wait = u32::from(wanted_from.saturating_sub(today));
    wanted_from.saturating_add((hash % (wait + 1)) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Cell;

    fn tile(passes: u32, day: u16) -> Tile {
        Tile::from_cells(vec![(7, Cell { hits: 3, passes, last_day: day, ..Cell::default() })]).unwrap()
    }

    /// Catches: a place that is never seen again, and one that is wanted although it is known.
    #[test]
    fn what_is_known_well_is_wanted_again_after_a_while() {
        let policy = DemandPolicy { enough_passes: 5, refresh_days: 14 };
        assert_eq!(policy.wanted_from(None), 0);
        assert_eq!(policy.wanted_from(Some(&Tile::default())), 0);
        assert_eq!(policy.wanted_from(Some(&tile(4, 1_000))), 0);
        assert_eq!(policy.wanted_from(Some(&tile(5, 1_000))), 1_014);
        assert_eq!(DemandPolicy { enough_passes: 0, ..policy }.wanted_from(Some(&tile(500, 1_000))), 0);
        assert_eq!(policy.wanted_from(Some(&tile(5, u16::MAX))), u16::MAX);
    }

    /// Catches: a fleet that comes on one day, and vehicles that never come.
    #[test]
    fn vehicles_spread_over_the_days() {
        let days: std::collections::BTreeSet<_> =
            (0..1_000).map(|hash| turn_of(hash, 1_014, 1_000)).collect();
        assert_eq!((days.len(), days.first(), days.last()), (15, Some(&1_014), Some(&1_028)));
        assert_eq!(turn_of(77, 0, 1_000), 0);
        assert_eq!(turn_of(77, 1_000, 1_000), 1_000);
    }
}
