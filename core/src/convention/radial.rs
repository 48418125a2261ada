//! Radial speeds and azimuths against the own motion.
//!
//! Each [`Reading`] is one way to read a return. A return that two readings expect more than two limits of the gate
//! apart tells them apart: it can stand still under one of them at most.

use std::f64::consts::TAU;

use super::{Convention, Finding};
use crate::doppler::sensor_velocity;
use crate::gate::Gate;
use crate::odometry::BodyVelocity;
use crate::scan::{Mount, ScanView};

/// Slower scans tell little apart, metres per second.
const SLOWEST_MPS: f64 = 2.0;
/// Returns that a finding rests on, at least.
const MIN_RETURNS: u64 = 100;
/// Share of the returns that tell two readings apart which must stand still under the suspected one.
const STANDS: f64 = 0.5;
/// Share of those, relative to that, which may stand still as they are: by chance, as where an azimuth is arbitrary.
const BY_CHANCE: f64 = 0.25;
/// The same for radial speeds free of the own motion: traffic that drives along shows none either, and beside it
/// something always stands.
const BESIDE_TRAFFIC: f64 = 0.1;
/// A reading that supposes more must explain more: this share of all returns.
const SIMPLER: f64 = 0.05;

/// Metres per second of a kilometre per hour.
const KMH: f64 = 1.0 / 3.6;

/// How a radial speed is read.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Speed {
    /// So many times the contract's.
    Times(f64),
    /// Free of the own motion.
    Compensated,
}

/// One way to read returns.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reading {
    speed: Speed,
    clockwise: bool,
    degrees: bool,
}

const READINGS: usize = 17;

impl Reading {
    /// The contract's, then what supposes little, then what supposes more.
    fn all() -> [Self; READINGS] {
        let read = |speed, clockwise, degrees| Self { speed, clockwise, degrees };
        let times = |factor, clockwise, degrees| read(Speed::Times(factor), clockwise, degrees);
        [
            times(1.0, false, false),
            times(-1.0, false, false),
            times(KMH, false, false),
            times(1.0, true, false),
            times(1.0, false, true),
            read(Speed::Compensated, false, false),
            times(-KMH, false, false),
            times(-1.0, true, false),
            times(-1.0, false, true),
            times(KMH, true, false),
            times(KMH, false, true),
            times(1.0, true, true),
            times(-KMH, true, false),
            times(-KMH, false, true),
            times(-1.0, true, true),
            times(KMH, true, true),
            times(-KMH, true, true),
        ]
    }

    fn conventions(self) -> Vec<Convention> {
        let mut all = Vec::new();
        match self.speed {
            Speed::Compensated => all.push(Convention::RadialSpeedCompensated),
            Speed::Times(factor) => {
                all.extend((factor < 0.0).then_some(Convention::RadialSpeedTowards));
                all.extend((factor.abs() < 1.0).then_some(Convention::RadialSpeedKmh));
            }
        }
        all.extend(self.clockwise.then_some(Convention::AzimuthClockwise));
        all.extend(self.degrees.then_some(Convention::AzimuthDegrees));
        all
    }

    /// By how much a return misses what stands still, metres per second. `standing` is what a standing object
    /// shows at the azimuth read in radians and in degrees, each counter-clockwise and clockwise.
    fn residual(self, measured: f64, standing: &[[f64; 2]; 2]) -> f64 {
        let expected = standing[usize::from(self.degrees)][usize::from(self.clockwise)];
        match self.speed {
            Speed::Times(factor) => factor * measured - expected,
            Speed::Compensated => measured,
        }
    }
}

/// Returns that tell a reading from the contract's.
#[derive(Debug, Clone, Copy, Default)]
struct Apart {
    returns: u64,
    /// Stand still by the contract.
    as_is: u64,
    /// Stand still under the reading.
    read: u64,
}

/// What the returns of a radar showed so far.
#[derive(Debug, Clone)]
pub struct RadarTally {
    limit_mps: f64,
    returns: u64,
    /// Returns that stand still under each reading.
    standing: [u64; READINGS],
    apart: [Apart; READINGS],
    azimuths: u64,
    /// Azimuths larger than a full turn.
    beyond: u64,
}

impl Default for RadarTally {
    fn default() -> Self {
        Self {
            limit_mps: Gate::default().max_doppler_residual_mps,
            returns: 0,
            standing: [0; READINGS],
            apart: [Apart::default(); READINGS],
            azimuths: 0,
            beyond: 0,
        }
    }
}

impl RadarTally {
    /// All of several.
    #[must_use]
    pub fn sum(tallies: &[Self]) -> Self {
        let mut all = Self::default();
        for tally in tallies {
            all.returns += tally.returns;
            all.azimuths += tally.azimuths;
            all.beyond += tally.beyond;
            for index in 0..READINGS {
                all.standing[index] += tally.standing[index];
                all.apart[index].returns += tally.apart[index].returns;
                all.apart[index].as_is += tally.apart[index].as_is;
                all.apart[index].read += tally.apart[index].read;
            }
        }
        all
    }

    /// Counts the returns of a scan.
    pub fn see(&mut self, scan: &ScanView<'_>, mount: &Mount, velocity: BodyVelocity) {
        self.azimuths += scan.azimuth_rad.len() as u64;
        self.beyond += scan.azimuth_rad.iter().filter(|a| f64::from(a.abs()) > TAU).count() as u64;
        if velocity.speed_mps() < SLOWEST_MPS {
            return;
        }
        let [vx, vy] = sensor_velocity(mount, velocity);
        let readings = Reading::all();
        for (row, measured) in scan.radial_speed_mps.iter().enumerate() {
            let azimuth = f64::from(scan.azimuth_rad[row]);
            let level = scan.elevation_rad.get(row).map_or(1.0, |e| f64::from(*e).cos());
            let standing = [azimuth, azimuth.to_radians()].map(|azimuth| {
                let (s, c) = azimuth.sin_cos();
                [-level * (vx * c + vy * s), -level * (vx * c - vy * s)]
            });
            self.count(&readings, f64::from(*measured), &standing);
        }
    }

    fn count(&mut self, readings: &[Reading; READINGS], measured: f64, standing: &[[f64; 2]; 2]) {
        let limit = self.limit_mps;
        let as_is = readings[0].residual(measured, standing);
        self.returns += 1;
        for (index, reading) in readings.iter().enumerate() {
            let residual = reading.residual(measured, standing);
            let stands = residual.abs() <= limit;
            self.standing[index] += u64::from(stands);
            if (residual - as_is).abs() > 2.0 * limit {
                let apart = &mut self.apart[index];
                apart.returns += 1;
                apart.as_is += u64::from(as_is.abs() <= limit);
                apart.read += u64::from(stands);
            }
        }
    }

    /// The finding that most azimuths are larger than a full turn.
    #[must_use]
    pub fn beyond_a_turn(&self) -> Option<Finding> {
        let (beyond, of) = (self.beyond, self.azimuths);
        (of >= MIN_RETURNS && 2 * beyond > of).then_some(Finding::BeyondATurn { beyond, of })
    }

    /// The finding that returns seem to move: where another reading explains them, or where most of them do.
    #[must_use]
    pub fn moving(&self, sensor: Option<usize>) -> Option<Finding> {
        let (of, moving) = (self.returns, self.returns - self.standing[0]);
        let suspects = self.suspected().map(Reading::conventions).unwrap_or_default();
        let told = of >= MIN_RETURNS && (!suspects.is_empty() || 2 * moving > of);
        told.then_some(Finding::Moving { moving, of, sensor, suspects })
    }

    /// The simplest reading of those that explain most.
    fn suspected(&self) -> Option<Reading> {
        let mut best: Option<usize> = None;
        for index in (1..READINGS).filter(|index| self.is_suspect(*index)) {
            let gained = |than: usize| {
                self.standing[index] as f64 - self.standing[than] as f64 > SIMPLER * self.returns as f64
            };
            if best.is_none_or(gained) {
                best = Some(index);
            }
        }
        best.map(|index| Reading::all()[index])
    }

    fn is_suspect(&self, index: usize) -> bool {
        let Apart { returns, as_is, read } = self.apart[index];
        let by_chance = match Reading::all()[index].speed {
            Speed::Compensated => BESIDE_TRAFFIC,
            Speed::Times(_) => BY_CHANCE,
        };
        returns >= MIN_RETURNS
            && read as f64 >= STANDS * returns as f64
            && as_is as f64 <= by_chance * read as f64
    }
}
