//! A drawn world: its town, the drives that map it, the drive that asks.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::Family;
use super::fleet::{Contribution, Pace};
use super::range::{FamilyRange, Ground, Stale};
use crate::city::{Change, City, CityParams, Network, Plot, Structure};
use crate::downtown;
use crate::drive::{DriveParams, simulate};
use crate::error::Error;
use crate::odometry::{DeadReckoning, OdometryModel};
use crate::radar::RadarSpec;
use crate::reference::PoseError;
use crate::rng::{Purpose, stream, uniform};
use crate::route::Route;

/// Days from the survey's first to the drive that asks: enough that every car has moved.
const ASKING_DAY: u32 = 40;
/// On this day what has changed changes.
const CHANGE_DAY: u32 = 30;
/// From one street of a world to the next, metres.
const STREETS_APART_M: f64 = 100.0;
/// Length of the way of the vehicle that asks, metres.
const ASKING_M: f64 = 450.0;
/// Length of a plot that is torn down or built as one, metres.
const PLOT_M: f64 = 22.0;
/// The vehicle that asks.
const ASKING: u64 = 900;

/// A world of a family.
#[derive(Debug, Clone)]
pub struct FamilyWorld {
    /// Its family.
    pub family: Family,
    /// Its seed.
    pub seed: u64,
    /// What it was drawn from.
    pub range: FamilyRange,
    /// The town, with what changes in it.
    pub city: City,
    /// How many contribute.
    pub contributors: usize,
    radars: Vec<RadarSpec>,
}

impl Family {
    /// The world of a seed.
    ///
    /// # Errors
    /// Never with the ranges used here: all of them are valid.
    pub fn world(self, seed: u64) -> Result<FamilyWorld, Error> {
        let mut rng = stream(seed, Purpose::Family, self.number(), 0);
        let range = self.range(rng.random());
        let contributors = rng.random_range(inclusive(range.contributors));
        let radars = radars(&range, &mut rng);
        let city = changing(city(&range, seed, &mut rng)?, range.stale, &mut rng)?;
        Ok(FamilyWorld { family: self, seed, range, city, contributors, radars })
    }
}

fn inclusive((least, most): (usize, usize)) -> RangeInclusive<usize> {
    least..=most
}

/// A factor, drawn evenly in its logarithm.
fn factor(rng: &mut ChaCha8Rng, (low, high): (f64, f64)) -> f64 {
    uniform(rng, (low.ln(), high.ln())).exp()
}

fn radars(range: &FamilyRange, rng: &mut ChaCha8Rng) -> Vec<RadarSpec> {
    let (density, clutter) = (factor(rng, range.density), factor(rng, range.clutter));
    let noise = factor(rng, range.noise);
    let drawn = |mut radar: RadarSpec| {
        radar.sensitivity *= density.min(1.0);
        radar.returns *= density.max(1.0);
        radar.max_detections = (radar.max_detections as f64 * density.max(1.0).max(clutter)) as usize;
        radar.clutter.moving *= clutter;
        radar.clutter.at_rest *= clutter;
        radar.noise.range_m *= noise;
        radar.noise.azimuth_rad *= noise;
        radar
    };
    range.rig.radars().into_iter().map(drawn).collect()
}

fn city(range: &FamilyRange, seed: u64, rng: &mut ChaCha8Rng) -> Result<City, Error> {
    let town = downtown::city(seed);
    let params = CityParams { parking_occupancy: uniform(rng, range.occupancy), ..town };
    match range.ground {
        Ground::Town => City::generate(&CityParams { blocks_x: 2, blocks_y: 1, ..params }),
        Ground::Streets(style, length_m) => {
            let network = Network::side_by_side(2, STREETS_APART_M, (length_m, style.kerb_m, style.front_m));
            let (mut structure, mut slots) = (Structure::default(), Vec::new());
            for (index, street) in network.streets().iter().enumerate() {
                slots.extend(style.build(&mut structure, street, (seed, index), rng));
            }
            City::assembled(&params, network, structure, slots)
        }
    }
}

fn changing(city: City, stale: Stale, rng: &mut ChaCha8Rng) -> Result<City, Error> {
    let ((low, high), roadworks) = match stale {
        Stale::Nothing => return Ok(city),
        Stale::Fronts(low, high) => ((low, high), false),
        Stale::Roadworks(low, high) => ((low, high), true),
    };
    let fraction = uniform(rng, (low, high));
    let mut changes = Vec::new();
    for (number, street) in city.network().streets().iter().enumerate() {
        for left in [false, true] {
            for k in 0..(street.length_m() / PLOT_M) as usize {
                let along_m = k as f64 * PLOT_M..(k + 1) as f64 * PLOT_M;
                if rng.random_bool(fraction) {
                    let plot = Plot { street: number, left, along_m };
                    let built = rng.random_bool(0.5);
                    let change = if built { Change::Built } else { Change::Demolished };
                    changes.push(change(plot, CHANGE_DAY));
                }
            }
        }
        if roadworks && rng.random_bool(0.5) {
            changes.push(Change::Roadworks(number, CHANGE_DAY..u32::MAX));
        }
    }
    city.changing(&changes)
}

impl FamilyWorld {
    /// The radars of all its vehicles.
    #[must_use]
    pub fn radars(&self) -> &[RadarSpec] {
        &self.radars
    }

    /// Does the rig measure radial speeds?
    #[must_use]
    pub fn has_doppler(&self) -> bool {
        self.range.rig.has_doppler()
    }

    /// What one of the contributors drives on its day.
    ///
    /// # Errors
    /// Never with the ranges used here.
    pub fn contribution(&self, number: usize) -> Result<Contribution, Error> {
        let mut rng = self.rng(1 + number as u64);
        let (error, declared) = self.range.poses.draw(&mut rng);
        let mut drives = Vec::new();
        for (part, route) in self.survey_routes(number).into_iter().enumerate() {
            let route = driven(route, self.range.survey, &mut rng);
            let vehicle = 10 * number as u64 + part as u64;
            let mut drive = self.drive(vehicle, number as u32, &route, self.range.survey, error)?;
            for pose in &mut drive.reference {
                (pose.sigma_position_m, pose.sigma_yaw_rad) = declared;
            }
            drives.push(drive);
        }
        Ok(Contribution { contributor: number as u64, drives })
    }

    /// The drive that asks, on a later day.
    ///
    /// # Errors
    /// Never with the ranges used here.
    pub fn asking(&self) -> Result<Drive, Error> {
        let mut rng = self.rng(0);
        let route = match self.range.ground {
            Ground::Town => Route::wander(&self.city, self.seed + ASKING, ASKING_M),
            Ground::Streets(..) => Route::along(&self.city, &[0, 1]),
        };
        let route = driven(route, self.range.asking, &mut rng);
        self.drive(ASKING, ASKING_DAY, &route, self.range.asking, PoseError::default())
    }

    fn survey_routes(&self, number: usize) -> Vec<Route> {
        match self.range.ground {
            Ground::Town => vec![Route::survey(&self.city, 1000 * self.seed + number as u64)],
            // Every third contributor drives the other way.
            Ground::Streets(..) if number % 3 == 2 => {
                [[1, 0], [3, 2]].map(|nodes| Route::along(&self.city, &nodes)).into()
            }
            Ground::Streets(..) => [[0, 1], [2, 3]].map(|nodes| Route::along(&self.city, &nodes)).into(),
        }
    }

    fn drive(
        &self,
        vehicle: u64,
        day: u32,
        route: &Route,
        pace: Pace,
        pose_error: PoseError,
    ) -> Result<Drive, Error> {
        let base = downtown::drive();
        let params = DriveParams {
            vehicle: format!("{}-{}-{vehicle}", self.family.word(), self.seed),
            seed: self.seed * 1000 + vehicle,
            start_time_us: base.start_time_us + i64::from(day) * DAY_US,
            radars: self.radars.clone(),
            motion: pace.motion(),
            pose_error,
            odometry: OdometryModel::DeadReckoning(DeadReckoning::default()),
            ..base
        };
        let mut drive = simulate(&self.city.on_day(day), route, &params)?;
        if !self.has_doppler() {
            drive.scans.iter_mut().for_each(|scan| scan.radial_speed_mps = Vec::new());
        }
        Ok(drive)
    }

    fn rng(&self, index: u64) -> ChaCha8Rng {
        stream(self.seed, Purpose::Family, self.family.number(), 1 + index)
    }
}

/// A route as it is driven: with places to stop, and swaying within the lane.
fn driven(route: Route, pace: Pace, rng: &mut ChaCha8Rng) -> Route {
    let route = match pace.stops_m() {
        Some(spacing_m) => route.with_stops(spacing_m * uniform(rng, (0.7, 1.3))),
        None => route,
    };
    let phase_rad = uniform(rng, (0.0, TAU));
    route.swaying(uniform(rng, (0.1, 0.35)), uniform(rng, (60.0, 120.0)), phase_rad)
}
