//! Which uploads are made: places that vehicles pass, what the service wants of them, and what vehicles know of that. The
//! policy and the vehicles' turns are those of `core/src/demand.rs`.

use std::collections::HashMap;

use clap::ValueEnum;
use echofix_core::demand::{DemandPolicy, turn_of};
use echofix_core::evidence::Cell;
use echofix_core::tile::Tile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::day::{mean_share, share_at};

/// How vehicles learn what is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
pub enum Told {
    /// Nothing is said: all is uploaded.
    Nothing,
    /// By the answers to their own uploads only.
    Uploads,
    /// By asking for the coverage of their way when they set out, up to an hour before.
    Coverage,
}

/// Days until an upload is seen in what the service says: a minute's drive, and folding.
const SEEN_AFTER: f64 = 2.0 / 1440.0;
/// A vehicle asks for coverage up to so many days before it passes.
const SET_OUT: f64 = 1.0 / 24.0;
/// Passes a day of one vehicle over a place it comes to: there and back.
const OFTEN: f64 = 2.0;
/// The first day, since the Unix epoch.
const FIRST: u16 = 20_000;
/// Days that are simulated, and those of them after which a place counts as known.
const DAYS: u16 = 84;
const KNOWN_AFTER: u16 = 42;

/// Uploads of one place.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Wanted {
    /// A day, once it is known.
    pub a_day: f64,
    /// Until then, over all days.
    pub at_first: f64,
}

/// Uploads of a place with so many passes a day; the mean of some places.
pub(super) fn of_place(
    told: Told,
    policy: DemandPolicy,
    passes_a_day: f64,
    places: u32,
    seed: u64,
) -> Wanted {
    let mut sum = Wanted::default();
    for place in 0..places {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(u64::from(place));
        let mut place = Place::new(told, policy, passes_a_day);
        for day in 0..DAYS {
            let uploads = place.day(day, passes_a_day, &mut rng);
            if day < KNOWN_AFTER {
                sum.at_first += uploads;
            } else {
                sum.a_day += uploads / f64::from(DAYS - KNOWN_AFTER);
            }
        }
    }
    Wanted { a_day: sum.a_day / f64::from(places), at_first: sum.at_first / f64::from(places) }
}

struct Place {
    told: Told,
    policy: DemandPolicy,
    vehicles: u32,
    passes: u32,
    /// What the service says, and since when; the newest last.
    says: Vec<(f64, u16)>,
    /// The turns that vehicles were told.
    turns: HashMap<u32, u16>,
}

impl Place {
    fn new(told: Told, policy: DemandPolicy, passes_a_day: f64) -> Self {
        let vehicles = (passes_a_day / OFTEN).ceil().max(1.0) as u32;
        Self { told, policy, vehicles, passes: 0, says: vec![(0.0, 0)], turns: HashMap::new() }
    }

    /// The uploads of a day.
    fn day(&mut self, day: u16, passes_a_day: f64, rng: &mut ChaCha8Rng) -> f64 {
        if self.told == Told::Nothing {
            return passes_a_day;
        }
        let mut uploads = 0.0;
        let mut time = f64::from(day);
        // The gaps of the busiest hour; a pass at another one happens with the share of that hour.
        let busiest = passes_a_day / mean_share();
        loop {
            time += -rng.random::<f64>().max(f64::MIN_POSITIVE).ln() / busiest;
            if time >= f64::from(day) + 1.0 {
                return uploads;
            }
            if rng.random::<f64>() < share_at(time.fract() * 24.0) {
                let vehicle = rng.random_range(0..self.vehicles);
                let set_out = time - SET_OUT * rng.random::<f64>();
                uploads += f64::from(u8::from(self.passed(vehicle, set_out, time)));
            }
        }
    }

    /// Does a vehicle that passes upload?
    fn passed(&mut self, vehicle: u32, set_out: f64, time: f64) -> bool {
        let today = FIRST + time as u16;
        let turn = match self.told {
            Told::Coverage => turn_of(hash(vehicle), self.said(set_out), today),
            _ => self.turns.get(&vehicle).copied().unwrap_or(0),
        };
        if turn > today {
            return false;
        }
        let said = self.said(time);
        self.turns.insert(vehicle, if said == 0 { 0 } else { turn_of(hash(vehicle), said, today) });
        self.passes += 1;
        let cell = Cell { hits: 3, passes: self.passes, last_day: today, ..Cell::default() };
        let wanted = self.policy.wanted_from(Tile::from_cells(vec![(0, cell)]).as_ref());
        self.says.push((time + SEEN_AFTER, wanted));
        // Nobody set out so long ago that an older one counts.
        let old = self.says.partition_point(|(since, _)| *since <= time - SET_OUT);
        self.says.drain(..old.saturating_sub(1));
        true
    }

    /// What the service said at a time.
    fn said(&self, time: f64) -> u16 {
        let known = self.says.iter().rev().find(|(since, _)| *since <= time);
        known.map_or(0, |(_, wanted)| *wanted)
    }
}

fn hash(vehicle: u32) -> u32 {
    vehicle.wrapping_mul(0x9e37_79b9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uploads(told: Told, passes: f64) -> Wanted {
        of_place(told, DemandPolicy::default(), passes, 20, 1)
    }

    /// Catches: a simulated demand that is not what the policy says: ten passes at first, then one in fourteen days, and of all
    /// vehicles each in its turn where they learn from their own uploads only.
    #[test]
    fn what_is_wanted_is_uploaded() {
        let policy = DemandPolicy::default();
        let quiet = uploads(Told::Coverage, 4.0);
        let due = 1.0 / f64::from(policy.refresh_days);
        assert!((due * 0.9..due * 1.6).contains(&quiet.a_day), "{quiet:?}");
        assert!((10.0..16.0).contains(&quiet.at_first), "{quiet:?}");
        let (busy, alone) = (uploads(Told::Coverage, 400.0), uploads(Told::Uploads, 400.0));
        assert!(busy.a_day < alone.a_day && alone.a_day < 400.0 / 10.0, "{busy:?} {alone:?}");
        assert!((uploads(Told::Nothing, 400.0).a_day - 400.0).abs() < 1e-6);
        assert_eq!(uploads(Told::Coverage, 40.0), uploads(Told::Coverage, 40.0));
    }
}
