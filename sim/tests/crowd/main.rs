//! What a crowd's uploads make of a map: its own error, and what vetting makes of streets that repeat.
#![allow(clippy::print_stdout, reason = "figures are what the ignored tests are for")]

mod map;
mod poses;
mod rows;
