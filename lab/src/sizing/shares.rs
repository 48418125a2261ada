//! What of roads and vehicles each replica has, for one way to send regions to replicas.

use std::collections::BTreeMap;

use super::cache::{BEFORE, Streets, Visits};
use super::country::Region;
use super::day::{MINUTES, share_at};

/// Places by the sun, an hour and a half wide: their days are alike.
const PLACES_PER_HOUR: f64 = 4.0;

/// The days of all places.
#[derive(Debug, Clone)]
pub(super) struct Places {
    /// The share of vehicles on the road, by place and minute.
    pub shares: Vec<Vec<f64>>,
    /// The same summed up.
    pub visits: Vec<Visits>,
    west: i32,
}

impl Places {
    pub fn of(regions: &[Region]) -> Self {
        let place = |region: &Region| (region.hours_east * PLACES_PER_HOUR).round() as i32;
        let west = regions.iter().map(place).min().unwrap_or(0);
        let east = regions.iter().map(place).max().unwrap_or(0);
        let day = |place: i32| {
            let hours = f64::from(place) / PLACES_PER_HOUR;
            (0..MINUTES).map(|minute| share_at(minute as f64 / 60.0 + hours)).collect::<Vec<_>>()
        };
        let shares: Vec<_> = (west..=east).map(day).collect();
        let visits = shares.iter().map(|shares| Visits::of(shares)).collect();
        Self { shares, visits, west }
    }

    pub fn of_region(&self, region: &Region) -> usize {
        ((region.hours_east * PLACES_PER_HOUR).round() as i32 - self.west).max(0) as usize
    }
}

/// One replica's part.
#[derive(Debug, Clone, Default)]
pub(super) struct Part {
    /// Of all vehicles, by place: outside of the largest city, and in it.
    pub vehicles: Vec<[f64; 2]>,
    pub streets: Vec<Streets>,
}

/// How many there are, and how fast they come by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// Vehicles, were all on the road.
    pub vehicles: f64,
    pub road_km: f64,
    pub km_per_s: f64,
}

/// The parts of all replicas. `owner` says whose a region is, and the minute since which.
pub(super) fn parts(
    regions: &[Region],
    places: &Places,
    replicas: usize,
    scale: Scale,
    owner: impl Fn(&Region) -> (usize, f64),
) -> Vec<Part> {
    let empty = Part { vehicles: vec![[0.0; 2]; places.shares.len()], streets: Vec::new() };
    let mut parts = vec![empty; replicas];
    // Streets that are alike are one: place, since when, and how many vehicles come to a kilometre, to a third.
    let mut alike: BTreeMap<(usize, usize, i32, i32), [f64; 2]> = BTreeMap::new();
    for region in regions {
        let (replica, since) = owner(region);
        let place = places.of_region(region);
        parts[replica].vehicles[place][usize::from(region.in_largest_city)] += region.vehicle_share;
        let kind = ((region.vehicle_share / region.road_share).log2() * 2.0).round() as i32;
        let sum = alike.entry((replica, place, since as i32, kind)).or_default();
        sum[0] += region.road_share;
        sum[1] += region.vehicle_share;
    }
    for ((replica, place, since, _), [roads, vehicles]) in alike {
        let km = roads * scale.road_km;
        let visits_per_km_s = vehicles * scale.vehicles * scale.km_per_s / km;
        parts[replica].streets.push(Streets { km, visits_per_km_s, place, since: f64::from(since) });
    }
    parts
}

/// Since before all that counts.
pub(super) const ALWAYS: f64 = -(BEFORE as f64);

impl Part {
    /// Of all vehicles, those on its roads at a minute; in the largest city so many times as usual.
    pub fn on_the_road(&self, places: &Places, minute: usize, city: f64) -> f64 {
        let at = |(place, [others, largest]): (usize, &[f64; 2])| {
            places.shares[place][minute] * (others + largest * city)
        };
        self.vehicles.iter().enumerate().map(at).sum()
    }
}
