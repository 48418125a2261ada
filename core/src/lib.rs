//! The science of Echofix: pure functions and values. No I/O, no async, no clock, no globals.
//!
//! The paper implemented here is L. Narula, P. A. Iannucci, T. E. Humphreys,
//! "Automotive-Radar-Based 50-cm Urban Positioning" (2020); comments cite its equation and
//! algorithm labels. The rooms, in reading order:
//!
//! - [`pose`]: planar poses and how they compose.
//! - [`geo`]: WGS-84 to UTM and back, meridian convergence, scale factor, zones, tile ids.
//! - [`scan`]: one radar's detections at one time, and where the radar sits.
//! - [`odometry`]: the vehicle's relative trajectory, interpolated at scan times.
//! - [`datum`]: by how much vetting moved the passes over a tile: the map's own offset.
//! - [`drive`]: one recorded drive, and its segments that can be mapped from.
//! - [`doppler`]: the vehicle's own velocity and corrected odometry from radial speeds.
//! - [`gate`]: which detections pass, and why the others are dropped.
//! - [`batch`]: scans and odometry become one set of points in the frame of the newest pose.
//! - [`evidence`]: what a map cell knows; the evidence delta of an upload, and how it is built from scans
//!   and poses; the inverse sensor model.
//! - [`tile`]: 512 x 512 cells of 10 cm, sparse, with their codec; who voted; what is served.
//! - [`time`]: microseconds and days.
//! - [`varint`]: the alphabet of all codecs.
//! - [`window`]: the map around a prior, stitched from tiles, ready to be aligned against.
//! - [`agreement`]: nearest-neighbour questions: how well do points agree with the map?
//! - [`align`]: `fast_global_align`, its engine, the refinement and the verdict.
//! - [`vetting`]: does an upload agree with the map, and how far beside it does it lie?
//!
//! Frames: the map is UTM metres (`f64`), x east, y north; the body is x forward, y left; yaw is
//! radians, counter-clockwise from east (of the grid inside this crate, see [`geo`]).

pub mod agreement;
pub mod align;
pub mod batch;
pub mod datum;
pub mod doppler;
pub mod drive;
pub mod evidence;
pub mod gate;
pub mod geo;
pub mod odometry;
pub mod pose;
pub mod scan;
mod sealed;
pub mod tile;
pub mod time;
pub mod varint;
pub mod vetting;
pub mod window;
