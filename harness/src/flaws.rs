//! What was recorded and cannot be used: told by reason, with the first place.

use std::fmt;

use echofix_client::drivelog::Flaws;
use serde::Serialize;

/// Records that were skipped for one reason.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SkippedRecords {
    /// The file of a folder, the topic of an MCAP file, or `scan`, `odometry` and `pose` of what the vehicle's library refused.
    pub part: String,
    /// The reason as a word.
    pub reason: &'static str,
    /// Records skipped.
    pub count: u64,
    /// Row, message number, or time in microseconds of the first.
    pub first: String,
    /// What is wrong with the first, in words.
    pub problem: String,
}

impl fmt::Display for SkippedRecords {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { part, reason, count, first, problem } = self;
        let records = if *count == 1 { "record" } else { "records" };
        write!(f, "{count} {records} skipped ({reason}), the first at {part}:{first}: {problem}")
    }
}

/// All that was skipped of a drive, and how else it was read than it says.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct DriveFlaws {
    /// By part and reason.
    pub skipped: Vec<SkippedRecords>,
    /// Units of times, parts put in order.
    pub notes: Vec<String>,
}

impl From<&Flaws> for DriveFlaws {
    fn from(flaws: &Flaws) -> Self {
        let skipped = flaws.skipped.iter().map(|skipped| SkippedRecords {
            part: skipped.part.clone(),
            reason: skipped.reason,
            count: skipped.count,
            first: skipped.first.to_string(),
            problem: skipped.problem.clone(),
        });
        Self { skipped: skipped.collect(), notes: flaws.notes.clone() }
    }
}

impl DriveFlaws {
    /// Counts a measurement that the vehicle's library refused.
    pub fn skip(&mut self, part: &str, time_us: i64, reason: &'static str, problem: &impl fmt::Display) {
        match self.skipped.iter_mut().find(|skipped| skipped.part == part && skipped.reason == reason) {
            Some(skipped) => skipped.count += 1,
            None => self.skipped.push(SkippedRecords {
                part: part.to_owned(),
                reason,
                count: 1,
                first: time_us.to_string(),
                problem: problem.to_string(),
            }),
        }
    }

    /// Adds what was told elsewhere.
    pub fn add(&mut self, other: Self) {
        self.skipped.extend(other.skipped);
        self.notes.extend(other.notes);
    }

    /// Records skipped, whatever the reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.skipped.iter().map(|skipped| skipped.count).sum()
    }

    /// One line for each.
    pub fn lines(&self) -> impl Iterator<Item = String> + '_ {
        self.skipped.iter().map(ToString::to_string).chain(self.notes.iter().cloned())
    }
}
