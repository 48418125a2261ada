//! Streets that are made to be mistaken: their structure repeats, runs on without a mark, or is missing.
//!
//! Each scene is a [`City`] of one straight street, so that everything that works on a town works on it.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use echofix_core::pose::Pose2;

use crate::city::{City, CityParams, Look, Network, ParkingSlot, ReflectorKind, Structure};
use crate::error::Error;
use crate::rng::{Purpose, stream, uniform};

/// Length of the street, metres.
const LENGTH_M: f64 = 900.0;
/// From the centre line to the kerb, metres.
const KERB_M: f64 = 6.5;
/// From the centre line to walls, metres.
const FRONT_M: f64 = 9.5;
/// Reflectors stand this far in front of their wall, so that it does not hide them, metres.
const PROUD_M: f64 = 0.03;

/// A kind of street.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scene {
    /// Rows of parked cars of one pitch, 4 to 6 m, and nothing else: a shift by one car fits as well.
    ParkedCars,
    /// Two facades, each bay like the next.
    RepeatedFacades,
    /// Two even walls: nothing distinguishes positions along them.
    Tunnel,
    /// Nothing stands there at all.
    OpenField,
}

impl Scene {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::ParkedCars, Self::RepeatedFacades, Self::Tunnel, Self::OpenField];

    /// Its name in a few words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ParkedCars => "parked cars",
            Self::RepeatedFacades => "repeated facades",
            Self::Tunnel => "tunnel",
            Self::OpenField => "open field",
        }
    }

    /// The street of a seed, which draws the pitch of what repeats.
    ///
    /// # Errors
    /// Never with the parameters used here: the origin is on the map.
    pub fn city(self, seed: u64) -> Result<City, Error> {
        let params =
            CityParams { seed, parking_occupancy: 0.95, traffic_per_km: 2.0, ..CityParams::default() };
        let network = Network::straight(LENGTH_M, KERB_M, FRONT_M);
        let mut rng = stream(seed, Purpose::Fronts, self as u64, 1);
        let pitch_m = uniform(&mut rng, (4.0, 6.0));
        let (mut structure, mut slots) = (Structure::default(), Vec::new());
        match self {
            Self::ParkedCars => slots = rows_of_slots(pitch_m),
            Self::RepeatedFacades => facades(&mut structure, pitch_m),
            Self::Tunnel => walls(&mut structure),
            Self::OpenField => (),
        }
        City::assembled(&params, network, structure, slots)
    }
}

/// The street's right side and its left.
const SIDES: [f64; 2] = [-1.0, 1.0];

/// The frame of the street, which the network lays along x around the origin: x along it from its start.
fn frame() -> Pose2 {
    Pose2::new(-0.5 * LENGTH_M, 0.0, 0.0)
}

/// Positions along the street, so far apart.
fn positions(spacing_m: f64) -> impl Iterator<Item = f64> {
    (0..(LENGTH_M / spacing_m) as usize).map(move |k| (k as f64 + 0.5) * spacing_m)
}

fn rows_of_slots(period_m: f64) -> Vec<ParkingSlot> {
    let row = |sign: f64| {
        let yaw_rad = if sign > 0.0 { PI } else { 0.0 };
        let slot = move |x| ParkingSlot {
            pose: frame().compose(&Pose2::new(x, sign * (KERB_M - 1.15), yaw_rad)),
            period_m,
        };
        positions(period_m).map(slot)
    };
    SIDES.into_iter().flat_map(row).collect()
}

/// Windows of one size at one spacing: each jamb is seen from one oblique side.
fn facades(structure: &mut Structure, pitch_m: f64) {
    let jamb = Look { kind: ReflectorKind::Corner, probability: 0.3, rcs_dbsm: 5.0, edge_rad: 1.2 };
    for sign in SIDES {
        structure.wall(&frame(), &[[0.0, sign * FRONT_M], [LENGTH_M, sign * FRONT_M]]);
        let (y, out) = (sign * (FRONT_M - PROUD_M), -sign * FRAC_PI_2);
        for x in positions(pitch_m) {
            for side in [-1.0, 1.0] {
                let facing = out - side * sign * FRAC_PI_4;
                structure.reflectors.push(jamb.at(&frame(), [x + side * 0.8, y], facing));
            }
        }
    }
}

/// Walls whose every decimetre answers alike.
fn walls(structure: &mut Structure) {
    let rough = Look { kind: ReflectorKind::Wall, probability: 0.06, rcs_dbsm: 0.0, edge_rad: 1.3 };
    for sign in SIDES {
        structure.wall(&frame(), &[[0.0, sign * FRONT_M], [LENGTH_M, sign * FRONT_M]]);
        for x in positions(0.1) {
            let position = [x, sign * (FRONT_M - PROUD_M)];
            structure.reflectors.push(rough.at(&frame(), position, -sign * FRAC_PI_2));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::{DriveParams, simulate};
    use crate::plane::distance;
    use crate::radar::Clutter;
    use crate::route::Route;

    #[test]
    fn every_scene_can_be_driven_through() {
        for scene in Scene::ALL {
            let city = scene.city(3).unwrap();
            assert!((city.streets_m() - LENGTH_M).abs() < 1e-9);
            let route = Route::survey(&city, 1);
            assert!(route.length_m() > 0.9 * LENGTH_M, "{scene:?}: {}", route.length_m());
            let mut params = DriveParams { max_duration_s: 12.0, ..DriveParams::default() };
            for radar in &mut params.radars {
                radar.clutter = Clutter { moving: 0.0, at_rest: 0.0 };
            }
            let drive = simulate(&city.on_day(1), &route, &params).unwrap();
            let seen: usize = drive.scans.iter().map(echofix_core::scan::Scan::len).sum();
            let mean = seen as f64 / drive.scans.len() as f64;
            assert_eq!(mean > 5.0, scene != Scene::OpenField, "{scene:?}: {mean}");
        }
    }

    #[test]
    fn what_repeats_fits_again_one_pitch_on() {
        for seed in 0..4 {
            let facades = Scene::RepeatedFacades.city(seed).unwrap();
            let all = &facades.structure().reflectors;
            let pitch_m = distance(all[0].at, all[2].at);
            assert!((4.0..6.0).contains(&pitch_m), "seed {seed}: {pitch_m}");
            assert!(
                all.windows(3).filter(|w| (distance(w[0].at, w[2].at) - pitch_m).abs() < 1e-6).count() > 200
            );
            let slots = Scene::ParkedCars.city(seed).unwrap();
            let pitch_m = slots.slots()[0].period_m;
            assert!((4.0..6.0).contains(&pitch_m), "seed {seed}: {pitch_m}");
            assert!(slots.structure().reflectors.is_empty());
        }
    }
}
