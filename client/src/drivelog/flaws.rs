//! What a log holds that cannot be used: skipped, counted, and told by reason with the first place.

use std::fmt;

use super::Problem;

/// Records of one part of a log that were skipped for one reason.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Skipped {
    /// The file of a folder, or the topic of an MCAP file.
    pub part: String,
    /// The reason as one word that stays the same: see [`Problem::reason`].
    pub reason: &'static str,
    /// Records skipped.
    pub count: u64,
    /// The row of the file (from 1, with the header), or the number of the message in its topic, of the first one.
    pub first: u64,
    /// What is wrong with the first one, in words.
    pub problem: String,
}

impl fmt::Display for Skipped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { part, reason, count, first, problem } = self;
        let records = if *count == 1 { "record" } else { "records" };
        write!(f, "{count} {records} skipped ({reason}), the first at {part}:{first}: {problem}")
    }
}

/// All that was skipped of a log, and how else it was read than it says.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Flaws {
    /// What was skipped, by part and reason, in the order in which it was found.
    pub skipped: Vec<Skipped>,
    /// How it was read, where that is not as the format says: units of times, parts put in order.
    pub notes: Vec<String>,
}

impl Flaws {
    /// Nothing was skipped and nothing is to be told.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.skipped.is_empty() && self.notes.is_empty()
    }

    /// Records skipped, whatever the reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.skipped.iter().map(|skipped| skipped.count).sum()
    }

    /// Records skipped for a reason, in all parts.
    #[must_use]
    pub fn count(&self, reason: &str) -> u64 {
        self.skipped.iter().filter(|skipped| skipped.reason == reason).map(|skipped| skipped.count).sum()
    }

    /// Counts a record that is skipped.
    pub(super) fn skip(&mut self, part: &str, place: u64, problem: &Problem) {
        let reason = problem.reason();
        match self.skipped.iter_mut().find(|skipped| skipped.reason == reason && skipped.part == part) {
            Some(skipped) => {
                skipped.count += 1;
                if place < skipped.first {
                    (skipped.first, skipped.problem) = (place, problem.to_string());
                }
            }
            None => self.skipped.push(Skipped {
                part: part.to_owned(),
                reason,
                count: 1,
                first: place,
                problem: problem.to_string(),
            }),
        }
    }

    pub(super) fn note(&mut self, note: String) {
        self.notes.push(note);
    }
}

impl fmt::Display for Flaws {
    /// One line each.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let skipped = self.skipped.iter().map(ToString::to_string);
        let lines: Vec<_> = skipped.chain(self.notes.iter().cloned()).collect();
        f.write_str(&lines.join("\n"))
    }
}
