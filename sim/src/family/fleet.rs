//! Who drives: paces, and how well contributors know their poses.

use rand_chacha::ChaCha8Rng;

use crate::motion::MotionParams;
use crate::reference::PoseError;
use crate::rng::uniform;

/// How a vehicle is driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Town traffic: 5 to 12.5 m/s with stops at a third of the intersections.
    Town,
    /// 8 m/s throughout: no place is looked at longer than another.
    Constant,
    /// Stops of 2 to 20 s every 30 m or so, and starts again.
    StopAndGo,
    /// 1.2 to 3 m/s, with stops.
    Crawling,
    /// 20 to 35 m/s.
    Motorway,
}

/// Distance between places where a vehicle in dense traffic may stop, metres.
const STOPS_M: f64 = 30.0;

impl Pace {
    /// Speeds and stops.
    #[must_use]
    pub fn motion(self) -> MotionParams {
        let town = MotionParams::default();
        match self {
            Self::Town => MotionParams { cruise_mps: (5.0, 12.5), ..town },
            Self::Constant => MotionParams { cruise_mps: (8.0, 8.0), stop_probability: 0.0, ..town },
            Self::StopAndGo => MotionParams { cruise_mps: (4.0, 9.0), stop_probability: 0.6, ..town },
            Self::Crawling => MotionParams { cruise_mps: (1.2, 3.0), stop_probability: 0.3, ..town },
            Self::Motorway => MotionParams { cruise_mps: (20.0, 35.0), stop_probability: 0.0, ..town },
        }
    }

    /// Metres between places to stop besides intersections, if there are any.
    pub(super) fn stops_m(self) -> Option<f64> {
        matches!(self, Self::StopAndGo | Self::Crawling).then_some(STOPS_M)
    }
}

/// How well contributors know their poses, and what they say of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseQuality {
    /// One-sigma error of the position along each axis, metres: from, to.
    pub sigma_m: (f64, f64),
    /// One-sigma error of the heading, degrees: from, to.
    pub sigma_deg: (f64, f64),
    /// Time after which errors are others, seconds: from, to.
    pub correlation_s: (f64, f64),
    /// The true sigma as a multiple of the declared one: from, to. 1 is honest.
    pub overconfidence: (f64, f64),
}

impl PoseQuality {
    /// An inertial system with RTK, as in [`crate::downtown`].
    pub const SURVEY: Self = Self {
        sigma_m: (0.08, 0.12),
        sigma_deg: (0.1, 0.2),
        correlation_s: (30.0, 90.0),
        overconfidence: (1.0, 1.0),
    };

    /// One contributor's true errors, and the sigmas it declares: metres, radians.
    pub(super) fn draw(&self, rng: &mut ChaCha8Rng) -> (PoseError, (f64, f64)) {
        let sigma_position_m = uniform(rng, self.sigma_m);
        let sigma_yaw_rad = uniform(rng, self.sigma_deg).to_radians();
        let correlation_s = uniform(rng, self.correlation_s);
        let factor = uniform(rng, self.overconfidence);
        let declared = (sigma_position_m / factor, sigma_yaw_rad / factor);
        (PoseError { sigma_position_m, sigma_yaw_rad, correlation_s }, declared)
    }
}

/// One contributor's drives in a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Contribution {
    /// Its number.
    pub contributor: u64,
    /// Its drives on one day.
    pub drives: Vec<echofix_core::drive::Drive>,
}
