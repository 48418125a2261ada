//! One radar at work.

use echofix_core::pose::wrap_angle;
use echofix_core::scan::Scan;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::spec::{MIN_RANGE_M, RadarSpec};
use crate::city::{CityDay, Mover, Reflector};
use crate::motion::MotionState;
use crate::plane::{LineSegment, Point, dot, sub};
use crate::rng::{normal, poisson, uniform};

/// Range at which half the detections of a reflector of 0 dBsm are missed, metres.
const HALF_RANGE_M: f64 = 40.0;
/// Speed over which clutter at rest gives way to clutter while driving, metres per second.
const CLUTTER_FADE_MPS: f64 = 0.7;

/// One radar at work on one day, with its own stream of chance.
pub struct Scanner<'a> {
    day: &'a CityDay<'a>,
    spec: &'a RadarSpec,
    sensor: usize,
    rng: ChaCha8Rng,
}

/// The radar's pose and motion during one scan, and what moves around it.
struct Sight<'a> {
    at: Point,
    boresight: Point,
    yaw_rad: f64,
    velocity_mps: Point,
    movers: &'a [Mover],
    hiding: &'a [LineSegment],
}

/// From the radar to a reflector: range, azimuth from the boresight, unit vector.
struct LineOfSight {
    range_m: f64,
    azimuth_rad: f64,
    away: Point,
}

struct Echo {
    range_m: f64,
    azimuth_rad: f64,
    radial_speed_mps: f64,
    rcs_dbsm: f64,
}

impl Echo {
    /// Received power, decibel.
    fn power_db(&self) -> f64 {
        self.rcs_dbsm - 40.0 * self.range_m.log10()
    }
}

impl<'a> Scanner<'a> {
    /// A radar that is number `sensor` on its vehicle.
    #[must_use]
    pub fn new(day: &'a CityDay<'a>, spec: &'a RadarSpec, sensor: usize, rng: ChaCha8Rng) -> Self {
        Self { day, spec, sensor, rng }
    }

    /// Scans from a vehicle in some state; `movers` are the vehicles around it.
    pub fn scan(&mut self, time_us: i64, body: &MotionState, movers: &[Mover]) -> Scan {
        let pose = body.pose.compose(&self.spec.mount);
        let hiding: Vec<_> = movers.iter().flat_map(|m| m.vehicle.diagonals()).collect();
        let sight = Sight {
            at: [pose.x_m, pose.y_m],
            boresight: [pose.yaw_rad.cos(), pose.yaw_rad.sin()],
            yaw_rad: pose.yaw_rad,
            velocity_mps: body.velocity_of([self.spec.mount.x_m, self.spec.mount.y_m]),
            movers,
            hiding: &hiding,
        };
        let mut echoes = self.targets(&sight);
        echoes.extend(self.clutter(&sight, body.speed_mps));
        if echoes.len() > self.spec.max_detections {
            echoes.sort_by(|a, b| b.power_db().total_cmp(&a.power_db()));
            echoes.truncate(self.spec.max_detections);
        }
        self.columns(time_us, &echoes)
    }

    /// Detections of real things.
    fn targets(&mut self, sight: &Sight) -> Vec<Echo> {
        let (day, spec) = (self.day, self.spec);
        let mut echoes = Vec::with_capacity(spec.max_detections);
        let may_hold = |centre, radius_m| spec.may_see(sight.boresight, centre, radius_m);
        day.visit(sight.at, spec.max_range_m(), may_hold, |reflector| {
            self.echoes(sight, reflector, [0.0; 2], &mut echoes);
        });
        for mover in sight.movers {
            for reflector in mover.vehicle.reflectors() {
                self.echoes(sight, &reflector, mover.velocity_mps, &mut echoes);
            }
        }
        echoes
    }

    /// The echoes of a reflector that moves at some velocity; none if it is not detected this time.
    fn echoes(&mut self, sight: &Sight, reflector: &Reflector, velocity_mps: Point, echoes: &mut Vec<Echo>) {
        let Some(line) = self.detected(sight, reflector) else { return };
        echoes.extend(self.echo(sight, reflector, &line, velocity_mps));
        if self.spec.returns > 1.0 {
            for _ in 0..poisson(&mut self.rng, self.spec.returns - 1.0) {
                echoes.extend(self.echo(sight, reflector, &line, velocity_mps));
            }
        }
    }

    /// The line of sight to a reflector, if it is detected this time.
    fn detected(&mut self, sight: &Sight, reflector: &Reflector) -> Option<LineOfSight> {
        let way = sub(reflector.at, sight.at);
        let range_m = way[0].hypot(way[1]);
        if range_m < MIN_RANGE_M || range_m > self.spec.max_range_m() || dot(way, sight.boresight) < 0.0 {
            return None;
        }
        let away = [way[0] / range_m, way[1] / range_m];
        let aspect = reflector.aspect([-away[0], -away[1]]);
        if aspect <= 0.0 {
            return None;
        }
        // The ray is the costly part, the range's part the next: they decide last, with the same draw.
        let near = self.spec.sensitivity * reflector.probability * aspect;
        let draw: f64 = self.rng.random();
        if draw >= near {
            return None;
        }
        let half_range_m = HALF_RANGE_M * 10_f64.powf(reflector.rcs_dbsm / 40.0);
        let chance = near / (1.0 + (range_m / half_range_m).powi(4));
        if draw >= chance || draw >= chance * self.seen_share(sight, reflector) {
            return None;
        }
        let azimuth_rad = wrap_angle(way[1].atan2(way[0]) - sight.yaw_rad);
        Some(LineOfSight { range_m, azimuth_rad, away })
    }

    /// One echo along a line of sight, if the radar sees where its errors put it.
    fn echo(
        &mut self,
        sight: &Sight,
        reflector: &Reflector,
        &LineOfSight { range_m, azimuth_rad, away }: &LineOfSight,
        velocity_mps: Point,
    ) -> Option<Echo> {
        let noise = self.spec.noise;
        let echo = Echo {
            range_m: range_m + normal(&mut self.rng, noise.range_m),
            azimuth_rad: azimuth_rad + normal(&mut self.rng, noise.azimuth_rad),
            radial_speed_mps: dot(sub(velocity_mps, sight.velocity_mps), away)
                + normal(&mut self.rng, noise.radial_speed_mps),
            rcs_dbsm: reflector.rcs_dbsm + normal(&mut self.rng, noise.rcs_db),
        };
        let seen = self.spec.sees(range_m, azimuth_rad) && self.spec.sees(echo.range_m, echo.azimuth_rad);
        seen.then_some(echo)
    }

    /// The fraction of the signal that walls, parked cars and traffic let pass.
    fn seen_share(&self, sight: &Sight, reflector: &Reflector) -> f64 {
        if sight.hiding.iter().any(|d| d.crossing(sight.at, reflector.at).is_some()) {
            return 0.0;
        }
        self.day.transmission(sight.at, reflector)
    }

    /// False detections: half of them at the speed of the stationary world, half at any speed.
    fn clutter(&mut self, sight: &Sight, speed_mps: f64) -> Vec<Echo> {
        let clutter = self.spec.clutter;
        let rest = (-speed_mps / CLUTTER_FADE_MPS).exp();
        let count = poisson(&mut self.rng, clutter.moving + rest * (clutter.at_rest - clutter.moving));
        let (max_range_m, max_angle_rad) = (self.spec.max_range_m(), self.spec.max_angle_rad());
        let rng = &mut self.rng;
        let mut echoes = Vec::with_capacity(count);
        while echoes.len() < count {
            let range_m = max_range_m * rng.random::<f64>().sqrt();
            let azimuth_rad = uniform(rng, (-max_angle_rad, max_angle_rad));
            if !self.spec.sees(range_m, azimuth_rad) {
                continue;
            }
            let (s, c) = (sight.yaw_rad + azimuth_rad).sin_cos();
            let still_mps = -dot(sight.velocity_mps, [c, s]);
            let other_mps = uniform(rng, (-15.0, 15.0));
            echoes.push(Echo {
                range_m,
                azimuth_rad,
                radial_speed_mps: if rng.random_bool(0.5) { still_mps } else { other_mps },
                rcs_dbsm: -8.0 + normal(rng, 4.0),
            });
        }
        echoes
    }

    fn columns(&self, time_us: i64, echoes: &[Echo]) -> Scan {
        let column = |value: fn(&Echo) -> f64| echoes.iter().map(|e| value(e) as f32).collect();
        Scan {
            sensor: self.sensor,
            time_us,
            range_m: column(|e| e.range_m),
            azimuth_rad: column(|e| e.azimuth_rad),
            radial_speed_mps: column(|e| e.radial_speed_mps),
            rcs_dbsm: column(|e| e.rcs_dbsm),
            ..Scan::default()
        }
    }
}
