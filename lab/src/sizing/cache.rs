//! Prepared tiles in a replica's memory: which share of the streets is warm.
//!
//! A cache that drops what was asked for longest ago keeps what was asked for within some time back, the same for all streets
//! (Che, Tung and Wang 2002); the time is what makes the sum fit. Vehicles come to a kilometre as a Poisson process.

/// Streets of one kind: as many vehicles come to each kilometre, over time as `Visits` of their place says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Streets {
    pub km: f64,
    /// Vehicles that come to a kilometre, a second, while the day's share is 1.
    pub visits_per_km_s: f64,
    /// Whose visits they have.
    pub place: usize,
    /// The minute since which they are asked for here.
    pub since: f64,
}

/// The integral of the day's share at one place, seconds, from a day before until each minute.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Visits(Vec<f64>);

/// Minutes before the day that are looked back on, at most.
pub(super) const BEFORE: usize = 2 * super::day::MINUTES;

impl Visits {
    /// Of the share at each minute of the day, the same on the days before.
    pub fn of(shares: &[f64]) -> Self {
        let mut sum = 0.0;
        let all = (0..=BEFORE + shares.len()).map(|minute| {
            let before = sum;
            sum += 60.0 * shares[minute % shares.len()];
            before
        });
        Self(all.collect())
    }

    /// Between two minutes of the day, which may be negative.
    fn between(&self, from: f64, until: f64) -> f64 {
        (self.at(until) - self.at(from)).max(0.0)
    }

    fn at(&self, minute: f64) -> f64 {
        let place = (minute + BEFORE as f64).clamp(0.0, (self.0.len() - 1) as f64);
        let (low, part) = (place as usize, place.fract());
        let high = (low + 1).min(self.0.len() - 1);
        self.0[low] * (1.0 - part) + self.0[high] * part
    }
}

impl Streets {
    /// The share that is warm at a minute, where the cache goes so many minutes back.
    pub fn warm(&self, visits: &[Visits], minute: f64, back: f64) -> f64 {
        let from = (minute - back).max(self.since);
        1.0 - (-self.visits_per_km_s * visits[self.place].between(from, minute)).exp()
    }
}

/// How many minutes back a cache of so many kilometres goes.
pub(super) fn back(streets: &[Streets], visits: &[Visits], minute: f64, room_km: f64) -> f64 {
    let held = |back: f64| streets.iter().map(|s| s.km * s.warm(visits, minute, back)).sum::<f64>();
    let (mut low, mut high) = (0.0, BEFORE as f64);
    if held(high) <= room_km {
        return high;
    }
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        if held(middle) > room_km { high = middle } else { low = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::collections::{BTreeMap, HashMap};

    /// Catches: a reckoned cache that is not what a cache does which drops what was asked for longest ago.
    #[test]
    fn it_is_what_a_cache_does() {
        let visits = [Visits::of(&[1.0; 1440])];
        let kinds = [(100, 0.02), (1_000, 0.002), (4_000, 0.000_2)];
        let streets: Vec<_> = kinds
            .iter()
            .map(|(km, rate)| Streets {
                km: f64::from(*km),
                visits_per_km_s: *rate,
                place: 0,
                since: -(BEFORE as f64),
            })
            .collect();
        let room = 900;
        let back = back(&streets, &visits, 1000.0, f64::from(room));
        let rate = |s: &Streets| s.km * s.visits_per_km_s;
        let misses: f64 = streets.iter().map(|s| rate(s) * (1.0 - s.warm(&visits, 1000.0, back))).sum();
        let reckoned = misses / streets.iter().map(rate).sum::<f64>();

        let (mut rng, mut newest, mut order) =
            (ChaCha8Rng::seed_from_u64(3), HashMap::new(), BTreeMap::new());
        let (mut asked, mut missed) = (0, 0);
        let total: f64 = streets.iter().map(rate).sum();
        for tick in 0..200_000_u32 {
            let mut draw = rng.random::<f64>() * total;
            let kind = streets
                .iter()
                .position(|s| {
                    draw -= rate(s);
                    draw < 0.0
                })
                .unwrap_or(2);
            let street = (kind, rng.random_range(0..kinds[kind].0));
            let known = newest.insert(street, tick);
            if let Some(before) = known {
                order.remove(&before);
            }
            order.insert(tick, street);
            if order.len() > room as usize {
                let (_, oldest) = order.pop_first().unwrap();
                newest.remove(&oldest);
            }
            if tick > 50_000 {
                asked += 1;
                missed += u32::from(known.is_none());
            }
        }
        let simulated = f64::from(missed) / f64::from(asked);
        assert!((reckoned - simulated).abs() < 0.01, "{reckoned} and {simulated}");
    }

    /// Catches: streets that are warm before they were ever asked for here.
    #[test]
    fn what_moved_is_cold_at_first() {
        let visits = [Visits::of(&[1.0; 1440])];
        let street = Streets { km: 1.0, visits_per_km_s: 0.1, place: 0, since: 500.0 };
        assert!(street.warm(&visits, 500.0, 1000.0).abs() < 1e-12);
        assert!((street.warm(&visits, 501.0, 1000.0) - (1.0 - (-6.0_f64).exp())).abs() < 1e-9);
    }
}
