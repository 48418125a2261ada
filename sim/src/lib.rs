//! A seeded radar city: streets, parked cars that change from day to day, traffic, radars and
//! odometry. The same seeds give the same bytes.
//!
//! ```
//! use echofix_sim::{City, CityParams, DriveParams, Route, simulate};
//!
//! # fn main() -> Result<(), echofix_sim::Error> {
//! let city = City::generate(&CityParams::default())?;
//! let route = Route::wander(&city, 7, 100.0);
//! let drive = simulate(&city.on_day(3), &route, &DriveParams::default())?;
//! assert!(drive.scans.len() > 500);
//! # Ok(())
//! # }
//! ```
//!
//! The rooms, from the ground up:
//!
//! - [`error`]: why a city or a drive cannot be made.
//! - [`rng`]: independent random streams by seed and purpose.
//! - [`plane`]: points and segments; `index`: which of them are near a point or along a ray.
//! - [`site`]: where the town lies on the globe.
//! - [`city`]: streets, building fronts, street furniture; parked cars and traffic of a day.
//! - [`scenes`]: single streets that are made to be mistaken.
//! - [`route`]: ways through the town: a survey of all streets, a random walk.
//! - [`motion`]: when a vehicle is where on its route.
//! - [`radar`]: what a radar can do, and one radar at work.
//! - [`odometry`], [`mod@reference`]: what the vehicle believes about its motion and its pose.
//! - [`drive`]: all of it together: one recorded drive.
//! - [`downtown`]: parameters that make all of it as hard as the paper's downtown.
//! - [`family`]: families of worlds that differ in all of it, to judge on what nothing was tuned on.
//!
//! Frames: city metres are ground metres around the city's origin, x towards grid east, y towards
//! grid north; [`Site`] turns them into map metres. The body's origin is the middle of the rear axle,
//! x forward, y left.

pub mod city;
pub mod downtown;
pub mod drive;
pub mod error;
pub mod family;
mod index;
pub mod motion;
pub mod odometry;
pub mod plane;
pub mod radar;
pub mod reference;
pub mod rng;
pub mod route;
pub mod scenes;
pub mod site;

pub use city::{City, CityDay, CityParams};
pub use drive::{DriveParams, simulate};
pub use error::Error;
pub use family::Family;
pub use odometry::{DeadReckoning, Drift, Growth, OdometryModel};
pub use radar::RadarSpec;
pub use reference::PoseError;
pub use route::Route;
pub use scenes::Scene;
pub use site::Site;
