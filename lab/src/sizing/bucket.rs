//! The journal that all replicas append to: segments, requests and bytes.

use serde::Serialize;

use super::costs::Costs;

/// A replica that has nothing to append looks at the next name so often, a second (`Pace::poll`).
const POLLS_PER_S: f64 = 2.0;
/// Requests of a replica's keeper, a second (`Pace::keep`): the newest manifest.
const KEPT_PER_S: f64 = 1.0 / 30.0;

/// Requests and bytes of all replicas together.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Traffic {
    pub segments: f64,
    pub puts: f64,
    pub gets: f64,
    pub gb_written: f64,
    pub gb_read: f64,
}

/// What an upload meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Appending {
    /// Segments a second.
    pub segments_per_s: f64,
    /// Replicas that have something to append while one does.
    pub others: f64,
    /// Until an upload is acknowledged, ms.
    pub acknowledged_ms: f64,
}

/// Appends of so many uploads a second by so many replicas. One segment is put at a time, by whichever replica wins; a replica
/// puts all that wait there. Where more come than segments can be put, all replicas compete and groups grow.
pub(super) fn appending(uploads_per_s: f64, replicas: usize, costs: &Costs) -> Appending {
    let rounds_per_s = 1000.0 / costs.append_ms;
    let load = uploads_per_s / rounds_per_s;
    let most = replicas.saturating_sub(1) as f64;
    // As many wait as before one server whose rounds are all alike, and no more than there are.
    let others = if load < 1.0 { (load / (1.0 - load)).min(most) } else { most };
    let segments_per_s = uploads_per_s.min(rounds_per_s);
    Appending { segments_per_s, others, acknowledged_ms: costs.append_ms * (1.0 + others) }
}

impl Traffic {
    /// Adds a minute in which so many uploads were appended, or none because the bucket was away.
    pub fn add_minute(&mut self, uploads: f64, replicas: usize, away: bool, costs: &Costs) {
        if away {
            return;
        }
        let appending = appending(uploads / 60.0, replicas, costs);
        let segments = 60.0 * appending.segments_per_s;
        let replicas = replicas as f64;
        self.segments += segments;
        // Who lost a race has put in vain.
        self.puts += segments * (1.0 + appending.others);
        // Each reads each segment of others, and with it whether there is a newer manifest; who appends looks for that, too.
        self.gets += segments * (2.0 * (replicas - 1.0) + 1.0 + appending.others);
        self.gets += 60.0 * replicas * (POLLS_PER_S + KEPT_PER_S);
        self.gb_written += uploads * costs.upload_kb * 1e-6;
        self.gb_read += uploads * costs.upload_kb * 1e-6 * (replicas - 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: more segments than the journal's single chain can take, and groups that lose uploads.
    #[test]
    fn one_segment_is_put_at_a_time() {
        let costs = Costs { append_ms: 20.0, upload_kb: 10.0, ..Costs::read(None).unwrap() };
        let few = appending(1.0, 8, &costs);
        let is = |value: f64, expected: f64| (value - expected).abs() < 1e-9;
        assert!(is(few.segments_per_s, 1.0) && few.others < 0.03 && few.acknowledged_ms < 21.0);
        let many = appending(400.0, 8, &costs);
        assert!(is(many.segments_per_s, 50.0) && is(many.others, 7.0) && is(many.acknowledged_ms, 160.0));
        let mut traffic = Traffic::default();
        traffic.add_minute(600.0, 3, false, &costs);
        assert!((traffic.gb_written - 0.006).abs() < 1e-12 && (traffic.gb_read - 0.012).abs() < 1e-12);
        let before = traffic;
        traffic.add_minute(0.0, 3, true, &costs);
        assert_eq!(traffic, before);
    }
}
