//! Families of worlds: each a documented range of towns, radars, drives and crowds, from which a seed draws a world.
//!
//! What is tuned on some families is judged on the others. The names and ranges:
//!
//! - [`Family`]: which there are. [`range`]: what each draws from.
//! - [`street`]: what stands along a drawn street. [`rig`]: the radars. [`fleet`]: who surveys, and how well they know
//!   their poses.
//! - [`world`]: a drawn world: its town, the drives that map it, the drive that asks.

mod fleet;
mod range;
mod rig;
mod street;
mod world;

pub use fleet::{Contribution, Pace, PoseQuality};
pub use range::{FamilyRange, Ground, Stale};
pub use rig::Rig;
pub use street::{Fronts, Parking, StreetStyle};
pub use world::FamilyWorld;

/// A family of worlds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// The towns of [`crate::downtown`], surveyed once: what everything was tuned on so far.
    Town,
    /// The same, mapped by five, published where three agree.
    CrowdOfThree,
    /// The same, mapped by five, published without a second opinion.
    CrowdOfOne,
    /// One front radar of sharp azimuth in streets with posts 1.4 to 2 m apart.
    SharpPosts,
    /// Rows of parked cars of a pitch of 6 m, and little else.
    ParkingRows,
    /// A tunnel with a joint every 5 m.
    TunnelJoints,
    /// Twice to four times the returns and the clutter.
    Dense,
    /// A quarter to half of the returns.
    Sparse,
    /// Two to six times the clutter, and no more than the usual returns.
    Cluttered,
    /// A 4D radar with some 1000 detections a scan.
    Imaging,
    /// A spinning radar, which measures no radial speeds.
    Spinning,
    /// Four corner radars.
    Corners,
    /// Facades of a strict pitch.
    PeriodicFacades,
    /// Every car moved and a fifth of the fronts replaced since the survey.
    Renewed,
    /// Most fronts replaced since the survey, and roadworks.
    Rebuilt,
    /// A wide square: the fronts are far.
    Square,
    /// A motorway with the posts of guard rails.
    Motorway,
    /// A survey that crawls and stops.
    CrawlingSurvey,
    /// A vehicle that crawls where others surveyed at speed.
    CrawlingVehicle,
    /// Five contributors that know their poses to 0.25 m and 0.4 degrees, and say so.
    InexactCrowd,
    /// Contributors whose poses are 2 to 4 times worse than they say.
    Dishonest,
    /// Ten to twenty contributors, published where five agree.
    LargeCrowd,
    /// Range and azimuth noise half to twice the usual, clutter and density a quarter to four times, all at once.
    AnyRadar,
}

impl Family {
    /// All of them, in the order of the reports.
    pub const ALL: [Self; 23] = [
        Self::Town,
        Self::CrowdOfThree,
        Self::CrowdOfOne,
        Self::SharpPosts,
        Self::ParkingRows,
        Self::TunnelJoints,
        Self::Dense,
        Self::Sparse,
        Self::Cluttered,
        Self::Imaging,
        Self::Spinning,
        Self::Corners,
        Self::PeriodicFacades,
        Self::Renewed,
        Self::Rebuilt,
        Self::Square,
        Self::Motorway,
        Self::CrawlingSurvey,
        Self::CrawlingVehicle,
        Self::InexactCrowd,
        Self::Dishonest,
        Self::LargeCrowd,
        Self::AnyRadar,
    ];

    /// Its name on a command line and in tables.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Town => "town",
            Self::CrowdOfThree => "crowd-3",
            Self::CrowdOfOne => "crowd-1",
            Self::SharpPosts => "posts",
            Self::ParkingRows => "parking",
            Self::TunnelJoints => "tunnel",
            Self::Dense => "dense",
            Self::Sparse => "sparse",
            Self::Cluttered => "clutter",
            Self::Imaging => "imaging",
            Self::Spinning => "spinning",
            Self::Corners => "corners",
            Self::PeriodicFacades => "facades",
            Self::Renewed => "renewed",
            Self::Rebuilt => "rebuilt",
            Self::Square => "square",
            Self::Motorway => "motorway",
            Self::CrawlingSurvey => "crawling-survey",
            Self::CrawlingVehicle => "crawling-vehicle",
            Self::InexactCrowd => "inexact",
            Self::Dishonest => "dishonest",
            Self::LargeCrowd => "crowd-20",
            Self::AnyRadar => "any-radar",
        }
    }

    /// A number for its random streams, which stays when families are added (FNV-1a of its word).
    #[must_use]
    pub fn number(self) -> u64 {
        let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        self.word().bytes().fold(0xcbf2_9ce4_8422_2325, step)
    }

    /// The family of a [word](Self::word).
    #[must_use]
    pub fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|family| family.word() == word)
    }
}

#[cfg(test)]
mod tests;
