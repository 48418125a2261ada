//! What the service counts, in OpenMetrics text. No label ever names a vehicle.

use std::collections::HashMap;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

use crate::sparse;

/// What came of a request: a verdict, `COUNTED`, or the reason of a refusal.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct OutcomeLabel {
    /// One of a fixed set of words.
    pub outcome: &'static str,
}

/// The service's metrics.
pub struct Metrics {
    registry: Registry,
    /// Localization requests by outcome.
    pub fixes: Family<OutcomeLabel, Counter>,
    /// gRPC calls that were refused before their first answer, by code.
    pub refused: Family<OutcomeLabel, Counter>,
    /// Log lines that were left out because their kind had one shortly before.
    log_lines_left_out: Gauge,
    /// Uploads by outcome.
    pub uploads: Family<OutcomeLabel, Counter>,
    /// Seconds spent aligning a batch.
    pub align_seconds: Histogram,
    /// Seconds a localization request waited for a compute slot.
    pub queue_seconds: Histogram,
    /// Seconds from an upload's last byte to its acknowledgement.
    pub commit_seconds: Histogram,
    /// Requests whose tiles were all in the cache, and others, by outcome `hit` and `miss`.
    pub windows: Family<OutcomeLabel, Counter>,
    /// Sampled checks by outcome: the exact engine agrees (`agree`) or does not (`differ`), or too many
    /// wait to be checked (`skipped`).
    pub confirmations: Family<OutcomeLabel, Counter>,
    /// Uploads that vetting kept out of the map, by reason.
    pub quarantined: Family<OutcomeLabel, Counter>,
    /// Uploads that are in quarantine.
    pub in_quarantine: Gauge,
    /// Places where several contributors disagree with the map alike.
    pub alarms: Gauge,
    /// The end of the service's certificate, seconds since the Unix epoch; 0 without one.
    pub tls_not_after: Gauge,
    /// Times that certificates or tokens could not be read again.
    pub tls_reload_failures: Counter,
    /// Epoch of the map that is served.
    pub epoch: Gauge,
    /// Uploads in the journal that are not folded yet.
    pub unfolded: Gauge,
}

impl Default for Metrics {
    fn default() -> Self {
        let seconds = || Histogram::new(exponential_buckets(0.000_5, 2.0, 16));
        let mut metrics = Self {
            registry: Registry::with_prefix("echofix"),
            fixes: Family::default(),
            refused: Family::default(),
            log_lines_left_out: Gauge::default(),
            uploads: Family::default(),
            align_seconds: seconds(),
            queue_seconds: seconds(),
            commit_seconds: seconds(),
            windows: Family::default(),
            confirmations: Family::default(),
            quarantined: Family::default(),
            in_quarantine: Gauge::default(),
            alarms: Gauge::default(),
            tls_not_after: Gauge::default(),
            tls_reload_failures: Counter::default(),
            epoch: Gauge::default(),
            unfolded: Gauge::default(),
        };
        metrics.register();
        metrics
    }
}

impl Metrics {
    fn register(&mut self) {
        let r = &mut self.registry;
        let build = Info::new(vec![("version", env!("CARGO_PKG_VERSION"))]);
        r.register("build", "The version that runs", build);
        r.register("fixes", "Localization requests by outcome", self.fixes.clone());
        let help = "gRPC calls that were refused before their first answer, by code";
        r.register("refused_calls", help, self.refused.clone());
        let help = "Log lines left out because their kind had one shortly before";
        r.register("log_lines_left_out", help, self.log_lines_left_out.clone());
        r.register("uploads", "Uploads by outcome", self.uploads.clone());
        let mut seconds = |name, help, metric: &Histogram| {
            r.register_with_unit(name, help, Unit::Seconds, metric.clone());
        };
        seconds("align", "Time spent aligning a batch", &self.align_seconds);
        seconds("queue", "Time a localization request waited for a compute slot", &self.queue_seconds);
        seconds("commit", "Time from an upload's last byte to its acknowledgement", &self.commit_seconds);
        r.register("windows", "Requests by whether all their tiles were prepared", self.windows.clone());
        let help = "Sampled checks: answers repeated with an exact engine, by outcome";
        r.register("confirmations", help, self.confirmations.clone());
        let help = "Uploads that vetting kept out of the map, by reason";
        r.register("quarantined", help, self.quarantined.clone());
        r.register("in_quarantine", "Uploads in quarantine", self.in_quarantine.clone());
        let help = "Places where several contributors disagree with the map alike";
        r.register("alarms", help, self.alarms.clone());
        let help = "The end of the service's certificate, seconds since the Unix epoch; 0 without one";
        r.register("tls_not_after_seconds", help, self.tls_not_after.clone());
        let help = "Times that certificates or tokens could not be read again";
        r.register("tls_reload_failures", help, self.tls_reload_failures.clone());
        r.register("map_epoch", "Epoch of the map that is served", self.epoch.clone());
        r.register("unfolded_contributions", "Uploads in the journal not folded yet", self.unfolded.clone());
    }

    /// All metrics in Prometheus' older text format, for readers that ask for it.
    #[must_use]
    pub fn render_classic(&self) -> String {
        classic(&self.render())
    }

    /// All metrics as OpenMetrics text.
    #[must_use]
    pub fn render(&self) -> String {
        self.log_lines_left_out.set(sparse::left_out() as i64);
        let mut text = String::new();
        if let Err(error) = encode(&mut text, &self.registry) {
            tracing::error!(%error, "the metrics cannot be written down");
        }
        text
    }
}

/// OpenMetrics text in the format of before it: a counter is described under the name of its sample, and there are neither
/// units nor an end.
fn classic(text: &str) -> String {
    fn described<'a>(line: &'a str, what: &str) -> Option<(&'a str, &'a str)> {
        line.strip_prefix(what)?.split_once(' ')
    }
    let kinds: HashMap<&str, &str> = text.lines().filter_map(|line| described(line, "# TYPE ")).collect();
    let named = |name: &str| match kinds.get(name) {
        Some(&"counter") => format!("{name}_total"),
        Some(&"info") => format!("{name}_info"),
        _ => name.to_owned(),
    };
    let mut out = String::with_capacity(text.len());
    for line in text.lines() {
        if line.starts_with("# UNIT ") || line == "# EOF" {
            continue;
        }
        let line = if let Some((name, help)) = described(line, "# HELP ") {
            format!("# HELP {} {help}", named(name))
        } else if let Some((name, kind)) = described(line, "# TYPE ") {
            let kind = match kind {
                "info" => "gauge",
                "unknown" => "untyped",
                kind => kind,
            };
            format!("# TYPE {} {kind}", named(name))
        } else {
            line.to_owned()
        };
        out.push_str(&line);
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an older Prometheus that finds counters without a type, or takes the end for a line of its own.
    #[test]
    fn the_older_format_describes_each_sample_by_its_name() {
        let metrics = Metrics::default();
        metrics.fixes.get_or_create(&OutcomeLabel { outcome: "USABLE" }).inc();
        metrics.align_seconds.observe(0.01);
        let text = metrics.render_classic();
        for line in [
            "# TYPE echofix_fixes_total counter",
            "echofix_fixes_total{outcome=\"USABLE\"} 1",
            "# TYPE echofix_align_seconds histogram",
            "# TYPE echofix_map_epoch gauge",
            "# TYPE echofix_build_info gauge",
        ] {
            assert!(text.contains(&format!("{line}\n")), "{line}: {text}");
        }
        assert!(
            text.contains("echofix_build_info{version=\"")
                && !text.contains("# EOF")
                && !text.contains("# UNIT")
        );
    }

    #[test]
    fn what_was_counted_is_rendered() {
        let metrics = Metrics::default();
        metrics.fixes.get_or_create(&OutcomeLabel { outcome: "USABLE" }).inc();
        metrics.align_seconds.observe(0.01);
        let text = metrics.render();
        assert!(text.contains("echofix_fixes_total{outcome=\"USABLE\"} 1"), "{text}");
        assert!(text.contains("echofix_align_seconds_count 1"), "{text}");
        assert!(text.ends_with("# EOF\n"), "{text}");
    }
}
