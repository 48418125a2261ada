//! Why a cell is served, or why not.

use super::published::{WELL_SEEN, WELL_SEEN_CONTRIBUTORS};
use super::{Decay, Tile};
use crate::evidence::{Cell, support_block, view_block};

/// Whether a cell is served. The first reason that holds is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// It is.
    Served,
    /// Too few contributors hit something in its support block.
    TooFewContributors,
    /// Many passes had it in view, and too few contributors hit the cell itself.
    HitByTooFew,
    /// Nobody has confirmed it for too long.
    Expired,
    /// Nothing is left of its presence.
    Faded,
}

impl Tile {
    /// Whether a cell of this tile is among those that [`Tile::published`] serves under the same three, by its index.
    #[must_use]
    pub fn standing(
        &self,
        (index, cell): (u32, &Cell),
        min_contributors: u8,
        today: Option<u16>,
        decay: &Decay,
    ) -> Standing {
        if self.support[support_block(index)] < min_contributors {
            return Standing::TooFewContributors;
        }
        let alone = min_contributors.min(WELL_SEEN_CONTRIBUTORS);
        if cell.contributors < alone && self.observed[view_block(index)] >= WELL_SEEN {
            return Standing::HitByTooFew;
        }
        let Some(today) = today else { return Standing::Served };
        if today.saturating_sub(cell.last_day) > decay.expire_days {
            return Standing::Expired;
        }
        if decay.applied(*cell, today).is_none() { Standing::Faded } else { Standing::Served }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{folded, uploads};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Catches: a reason that says otherwise than what is served.
        #[test]
        fn what_is_served_stands_so(uploads in uploads(), least in 1..5_u8, later in prop::option::of(0..2_000_u16)) {
            let (tile, _) = folded(&uploads);
            let (decay, today) = (Decay::default(), later.map(|later| tile.newest_day().saturating_add(later)));
            let served = tile.published(least, today, &decay);
            for (index, cell) in tile.cells() {
                let stands = tile.standing((*index, cell), least, today, &decay) == Standing::Served;
                prop_assert_eq!(served.cells().iter().any(|(at, _)| at == index), stands);
            }
        }
    }
}
