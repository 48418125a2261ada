//! Statistics of many fixes; pure functions.
//!
//! - [`bootstrap`]: percentiles and fractions with confidence intervals.
//! - [`ccdf`]: how often is an error exceeded?
//! - [`calibration`]: are the errors as large as the covariances say?
//! - [`rank`]: do two quantities rise together?
//! - [`roc`]: does a score distinguish wrong answers from right ones?

pub mod bootstrap;
pub mod calibration;
pub mod ccdf;
pub mod rank;
pub mod roc;
