//! A fix as the filter takes it, and what becomes of it.

use echofix_core::geo::{self, LatLon};
use nalgebra::Matrix3;

use crate::vehicle::Fix;

/// One answer of the service: a pose at a past time with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixMeasurement {
    /// The time it is for, microseconds since the Unix epoch, on the clock of the odometry.
    pub time_us: i64,
    /// Position of the body's origin.
    pub at: LatLon,
    /// Heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// Covariance of (true east m, true north m, yaw rad): upper triangle row by row. It is the whole error,
    /// the map's own included.
    pub covariance: [f64; 6],
    /// Whether the answer holds the prior it was asked with, and not the batch and the map alone.
    pub contains_prior: bool,
    /// What that prior rested on.
    pub prior: PriorSource,
}

/// What the prior of a question rested on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorSource {
    /// Something this filter has not been fed with, for instance GNSS.
    Independent,
    /// This filter's estimate, or earlier fixes that it was fed with.
    Own,
}

impl From<&Fix> for FixMeasurement {
    /// The prior counts as [`PriorSource::Own`]: once it has a fix, a
    /// [`Vehicle`](crate::vehicle::Vehicle) asks around its fixes. Where it was pushed a pose from
    /// outside instead, say so.
    fn from(fix: &Fix) -> Self {
        Self {
            time_us: fix.pose.time_us,
            at: fix.pose.at,
            yaw_rad: fix.pose.yaw_rad,
            covariance: fix.covariance,
            contains_prior: fix.contains_prior,
            prior: PriorSource::Own,
        }
    }
}

/// What became of a fix.
///
/// A late fix makes the filter judge the fixes after it again; the outcome is that of the late fix
/// alone.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum FixOutcome {
    /// It corrected the estimate.
    Used {
        /// Normalised innovation squared: about 3 on average where the model is right.
        nis: f64,
    },
    /// There is no estimate yet, and too few fixes agree with this one to start it.
    Waiting {
        /// Fixes that agree, this one included.
        agreeing: usize,
    },
    /// Enough fixes agree: there is an estimate from here on.
    Started,
    /// It contradicts the estimate and was not used.
    Gated {
        /// Normalised innovation squared.
        nis: f64,
        /// Fixes in a row that contradict the estimate and agree with each other, this one
        /// included.
        agreeing: usize,
    },
    /// Enough fixes in a row contradicted the estimate and agree with each other: the filter has
    /// started over from them.
    Reset {
        /// Normalised innovation squared of the fix that tipped the scales.
        nis: f64,
    },
    /// It is for a time the history no longer reaches.
    TooOld {
        /// Where the history begins, microseconds since the Unix epoch.
        oldest_us: i64,
    },
    /// It is for a time that odometry does not cover yet: push it again later.
    AheadOfOdometry,
    /// There was a fix for this time already.
    Duplicate,
    /// It holds a prior that was this filter's own estimate, and would count that twice.
    HoldsOwnPrior,
}

/// Why a fix or an odometry pose is not one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A fix that is not on the map.
    #[error(transparent)]
    OffTheMap(#[from] geo::Error),
    /// A fix on another part of the globe.
    #[error("the fix at {at:?} is hundreds of kilometres away; if it is right, make a new filter")]
    FarAway {
        /// Where the fix is.
        at: LatLon,
    },
    /// A fix without a heading.
    #[error("the heading of the fix is {yaw_rad}; it must be finite, in radians")]
    NotAHeading {
        /// The heading given.
        yaw_rad: f64,
    },
    /// A matrix that is not a covariance, or of a fix that says next to nothing.
    #[error(
        "{covariance:?} is not the covariance of a fix (east m, north m, yaw rad; upper triangle): it must be \
         positive semidefinite with sigmas of at most {MAX_SIGMA_M} m and {MAX_SIGMA_RAD} rad"
    )]
    NotACovariance {
        /// The six values given.
        covariance: [f64; 6],
    },
    /// An odometry pose that is not finite or not newer than the last.
    #[error(transparent)]
    Odometry(#[from] echofix_core::odometry::Error),
    /// Odometry moved faster than a vehicle can, as when it starts over in another frame.
    #[error(
        "odometry jumped by {distance_m} m at {time_us} us; the filter starts over from there, \
         and waits for fixes"
    )]
    Jumped {
        /// The time of the pose after the jump.
        time_us: i64,
        /// Metres between the poses before and after.
        distance_m: f64,
    },
}

/// Beyond these the filter's linearisation is worth nothing: an estimate is given up, and a fix is
/// none.
pub(super) const MAX_SIGMA_M: f64 = 100.0;
pub(super) const MAX_SIGMA_RAD: f64 = 0.5;

impl FixMeasurement {
    /// The covariance as a matrix.
    ///
    /// # Errors
    /// When the position is outside UTM, the heading not finite or the covariance not one.
    pub(super) fn checked(&self) -> Result<Matrix3<f64>, Error> {
        geo::Zone::of(self.at)?;
        if !self.yaw_rad.is_finite() {
            return Err(Error::NotAHeading { yaw_rad: self.yaw_rad });
        }
        let [xx, xy, xt, yy, yt, tt] = self.covariance;
        let matrix = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
        let (most_m, most_rad) = (MAX_SIGMA_M.powi(2), MAX_SIGMA_RAD.powi(2));
        let bounded = xx <= most_m && yy <= most_m && tt <= most_rad;
        // What the wire rounds may leave a zero eigenvalue slightly negative.
        let rounded = matrix + Matrix3::from_diagonal(&[1e-8, 1e-8, 1e-10].into());
        if bounded && matrix.iter().all(|v| v.is_finite()) && rounded.cholesky().is_some() {
            Ok(matrix)
        } else {
            Err(Error::NotACovariance { covariance: self.covariance })
        }
    }
}
