//! Why a city or a drive cannot be made.

use echofix_core::{geo, odometry};

/// Why a city or a drive cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The town's position on the globe is not on the map.
    #[error("the city has no place on the map: {0}")]
    Place(#[from] geo::Error),
    /// A parameter is outside what the generator can lay out.
    #[error("`{name}` is {value}; it must be {expected}")]
    Parameter {
        /// The field.
        name: &'static str,
        /// What it was set to.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// The odometry that came out is not a trajectory: a model parameter was not finite.
    #[error("the odometry model gives no trajectory: {0}")]
    Odometry(#[from] odometry::Error),
}

/// Refuses a parameter outside `low..=high` (NaN included).
pub(crate) fn within(
    name: &'static str,
    value: f64,
    (low, high): (f64, f64),
    expected: &'static str,
) -> Result<(), Error> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(Error::Parameter { name, value, expected }) }
}
