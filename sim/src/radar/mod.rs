//! Automotive radars: sparse, noisy, cluttered (paper, Sec. "Automotive Radar Sensor
//! Characteristics").

mod scanner;
mod spec;

pub use scanner::Scanner;
pub use spec::{Clutter, FieldOfView, Noise, RadarSpec};
