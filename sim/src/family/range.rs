//! The range of each family.

use super::Family;
use super::fleet::{Pace, PoseQuality};
use super::rig::Rig;
use super::street::{Fronts, Parking, StreetStyle};

/// Where a world is laid out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ground {
    /// Two blocks of a town of [`crate::downtown`].
    Town,
    /// Two straight streets of a style, 100 m apart, so many metres long.
    Streets(StreetStyle, f64),
}

/// What is no longer as it was surveyed. Parked cars and traffic are always others on another day.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stale {
    /// Nothing.
    Nothing,
    /// A fraction of the fronts was torn down or built: from, to.
    Fronts(f64, f64),
    /// The same, and there are roadworks: from, to.
    Roadworks(f64, f64),
}

/// What a family draws from: a range is from, to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FamilyRange {
    /// The town.
    pub ground: Ground,
    /// The radars.
    pub rig: Rig,
    /// Factor on the returns of what stands there; drawn evenly in its logarithm, as all factors.
    pub density: (f64, f64),
    /// Factor on the clutter.
    pub clutter: (f64, f64),
    /// Factor on the noise of range and azimuth.
    pub noise: (f64, f64),
    /// How the contributors drive.
    pub survey: Pace,
    /// How the vehicle drives that asks.
    pub asking: Pace,
    /// Contributors.
    pub contributors: (usize, usize),
    /// Contributors that must agree for a cell to be served.
    pub publish: u8,
    /// How well contributors know their poses.
    pub poses: PoseQuality,
    /// What has changed since the survey.
    pub stale: Stale,
    /// Fraction of the slots taken.
    pub occupancy: (f64, f64),
}

/// A town surveyed once.
const TOWN: FamilyRange = FamilyRange {
    ground: Ground::Town,
    rig: Rig::Paper,
    density: (1.0, 1.0),
    clutter: (1.0, 1.0),
    noise: (1.0, 1.0),
    survey: Pace::Town,
    asking: Pace::Town,
    contributors: (1, 1),
    publish: 1,
    poses: PoseQuality::SURVEY,
    stale: Stale::Nothing,
    occupancy: (0.65, 0.85),
};

const CROWD: FamilyRange = FamilyRange { contributors: (5, 5), publish: 3, ..TOWN };

/// A street of a town.
const STREET: StreetStyle = StreetStyle {
    kerb_m: 6.5,
    front_m: 9.5,
    fronts: Fronts::Random,
    parking: Parking::Random,
    posts_m: None,
    furniture: true,
    things_per_100_m: 0.0,
};

/// A street with nothing along it.
const BARE: StreetStyle =
    StreetStyle { fronts: Fronts::Open, parking: Parking::Free, furniture: false, ..STREET };

/// Length of a street, metres.
const STREET_M: f64 = 330.0;
/// Length of a street that is crawled along, metres.
const SHORT_M: f64 = 180.0;
/// Length of a motorway, metres.
const MOTORWAY_M: f64 = 1200.0;

fn on(style: StreetStyle) -> FamilyRange {
    FamilyRange { ground: Ground::Streets(style, STREET_M), ..TOWN }
}

impl Family {
    /// What a world is drawn from. `pitch` is a draw from 0 to 1 that decides on spacings.
    pub(super) fn range(self, pitch: f64) -> FamilyRange {
        match self {
            Self::Town => TOWN,
            Self::CrowdOfThree => CROWD,
            Self::CrowdOfOne => FamilyRange { publish: 1, ..CROWD },
            Self::SharpPosts => {
                let posts = StreetStyle { posts_m: Some(1.4 + 0.6 * pitch), ..STREET };
                FamilyRange { rig: Rig::SharpFront, ..on(posts) }
            }
            Self::ParkingRows => {
                let rows = StreetStyle { parking: Parking::Rows(6.0), things_per_100_m: 2.0 * pitch, ..BARE };
                FamilyRange { occupancy: (0.9, 1.0), survey: Pace::StopAndGo, ..on(rows) }
            }
            Self::TunnelJoints => {
                let tunnel = StreetStyle {
                    kerb_m: 4.5,
                    front_m: 5.5,
                    fronts: Fronts::Tunnel(5.0),
                    things_per_100_m: pitch,
                    ..BARE
                };
                on(tunnel)
            }
            Self::Dense => FamilyRange { density: (2.0, 4.0), clutter: (2.0, 4.0), ..CROWD },
            Self::Sparse => FamilyRange { density: (0.25, 0.5), clutter: (0.25, 1.0), ..CROWD },
            Self::Cluttered => FamilyRange { density: (0.5, 1.0), clutter: (2.0, 6.0), ..CROWD },
            Self::Imaging => FamilyRange { rig: Rig::Imaging, contributors: (3, 5), publish: 2, ..TOWN },
            Self::Spinning => FamilyRange { rig: Rig::Spinning, contributors: (1, 5), ..TOWN },
            Self::Corners => FamilyRange { rig: Rig::Corners, contributors: (1, 5), ..TOWN },
            Self::PeriodicFacades => {
                let facades = Fronts::Periodic(2.8 + 3.2 * pitch);
                on(StreetStyle { fronts: facades, parking: Parking::Random, ..BARE })
            }
            Self::Renewed => FamilyRange { stale: Stale::Fronts(0.15, 0.25), ..CROWD },
            Self::Rebuilt => FamilyRange { stale: Stale::Roadworks(0.6, 0.9), ..CROWD },
            Self::Square => {
                let square = StreetStyle { front_m: 35.0 + 13.0 * pitch, things_per_100_m: 4.0, ..STREET };
                on(StreetStyle { parking: Parking::Free, ..square })
            }
            Self::Motorway => motorway(pitch),
            Self::CrawlingSurvey => FamilyRange { survey: Pace::Crawling, ..short(STREET) },
            Self::CrawlingVehicle => FamilyRange { asking: Pace::Crawling, ..short(STREET) },
            Self::InexactCrowd => {
                let poses =
                    PoseQuality { sigma_m: (0.25, 0.25), sigma_deg: (0.4, 0.4), ..PoseQuality::SURVEY };
                FamilyRange { poses, ..CROWD }
            }
            Self::Dishonest => {
                let poses = PoseQuality {
                    sigma_m: (0.2, 0.35),
                    sigma_deg: (0.2, 0.5),
                    overconfidence: (2.0, 4.0),
                    ..PoseQuality::SURVEY
                };
                FamilyRange { contributors: (1, 5), publish: 1, poses, ..TOWN }
            }
            Self::LargeCrowd => FamilyRange {
                contributors: (10, 20),
                publish: 5,
                ground: Ground::Streets(STREET, SHORT_M),
                ..TOWN
            },
            Self::AnyRadar => FamilyRange {
                density: (0.25, 4.0),
                clutter: (0.25, 4.0),
                noise: (0.5, 2.0),
                contributors: (3, 5),
                publish: 2,
                ..TOWN
            },
        }
    }
}

fn short(style: StreetStyle) -> FamilyRange {
    FamilyRange { ground: Ground::Streets(style, SHORT_M), ..TOWN }
}

fn motorway(pitch: f64) -> FamilyRange {
    let style = StreetStyle {
        kerb_m: 7.5,
        posts_m: Some([1.33, 2.0, 4.0][((3.0 * pitch) as usize).min(2)]),
        things_per_100_m: 3.0,
        ..BARE
    };
    FamilyRange {
        ground: Ground::Streets(style, MOTORWAY_M),
        survey: Pace::Motorway,
        asking: Pace::Motorway,
        ..TOWN
    }
}
