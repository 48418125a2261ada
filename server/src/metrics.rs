//! What the service counts, in OpenMetrics text. No label ever names a vehicle.

//!
//! - `classic`: the text format of before OpenMetrics.
//! - `process`: what the system knows of the process.
//! - `labels`: what is told apart; each set of labels is bounded.
//! - `figures`: what is looked up when somebody reads the metrics.

mod classic;
mod figures;
mod labels;
mod process;

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::sparse;
use classic::classic;
pub use figures::Figures;
use labels::BuildLabels;
pub use labels::{HttpLabels, MethodLabel, OutcomeLabel, PortLabel, ReasonLabel, RouteLabel, RpcLabels};
use process::Process;

/// Looks figures up when somebody reads the metrics.
type Look = Box<dyn Fn(&Figures) + Send + Sync>;

/// The service's metrics.
pub struct Metrics {
    registry: Registry,
    /// 1 for the version and the commit that run.
    build: Family<BuildLabels, Gauge>,
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
    /// Whether a new generation of the map is being made.
    pub rebuilding: Gauge,
    /// gRPC calls by method and code.
    pub rpcs: Family<RpcLabels, Counter>,
    /// Seconds of a gRPC call, to the end of its answer; of one without an end, to its beginning.
    pub rpc_seconds: Family<MethodLabel, Histogram, fn() -> Histogram>,
    /// HTTP requests by method, route and status.
    pub http: Family<HttpLabels, Counter>,
    /// Seconds of an HTTP request, to the beginning of its answer.
    pub http_seconds: Family<RouteLabel, Histogram, fn() -> Histogram>,
    /// Refused gRPC calls, by the reason that the caller was told.
    pub refusals: Family<ReasonLabel, Counter>,
    /// Open connections by port.
    pub connections: Family<PortLabel, Gauge>,
    /// Connections that were closed at once because there were too many.
    pub connections_turned_away: Family<PortLabel, Counter>,
    /// Messages to the webhook by outcome.
    pub webhook: Family<OutcomeLabel, Counter>,
    figures: Figures,
    looks: Mutex<Vec<Look>>,
}

impl Default for Metrics {
    fn default() -> Self {
        let seconds = || Histogram::new(exponential_buckets(0.000_5, 2.0, 16));
        let mut metrics = Self {
            registry: Registry::default(),
            build: Family::default(),
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
            rebuilding: Gauge::default(),
            rpcs: Family::default(),
            rpc_seconds: Family::new_with_constructor(call_seconds),
            http: Family::default(),
            http_seconds: Family::new_with_constructor(call_seconds),
            refusals: Family::default(),
            connections: Family::default(),
            connections_turned_away: Family::default(),
            webhook: Family::default(),
            figures: Figures::default(),
            looks: Mutex::default(),
        };
        metrics.register();
        metrics.register_calls();
        metrics
    }
}

impl Metrics {
    /// Notes which commit runs.
    pub fn built_from(&self, commit: &str) {
        let labels = BuildLabels { version: env!("CARGO_PKG_VERSION"), commit: commit.to_owned() };
        self.build.get_or_create(&labels).set(1);
    }

    fn register(&mut self) {
        self.registry.register_collector(Box::new(Process::starts_now()));
        let r = self.registry.sub_registry_with_prefix("echofix");
        r.register("build_info", "The version and the commit that run", self.build.clone());
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

    fn register_calls(&mut self) {
        let r = self.registry.sub_registry_with_prefix("echofix");
        r.register(
            "rebuilding",
            "1 while a new generation of the map is being made",
            self.rebuilding.clone(),
        );
        r.register("grpc_calls", "gRPC calls by method and code", self.rpcs.clone());
        let help = "Time of a gRPC call, to the end of its answer, or its beginning where it has no end";
        r.register_with_unit("grpc_call_duration", help, Unit::Seconds, self.rpc_seconds.clone());
        r.register("http_requests", "HTTP requests by method, route and status", self.http.clone());
        let help = "Time of an HTTP request, to the beginning of its answer";
        r.register_with_unit("http_request_duration", help, Unit::Seconds, self.http_seconds.clone());
        let help = "Refused gRPC calls, by the reason that the caller was told";
        r.register("refusals", help, self.refusals.clone());
        r.register("connections", "Open connections by port", self.connections.clone());
        let help = "Connections closed at once because there were too many";
        r.register("connections_turned_away", help, self.connections_turned_away.clone());
        r.register("alarm_messages", "Messages to the webhook of alarms by outcome", self.webhook.clone());
        self.figures.register(r);
    }

    /// Figures that are looked up whenever somebody reads the metrics.
    pub fn look_up(&self, look: impl Fn(&Figures) + Send + Sync + 'static) {
        self.looks.lock().unwrap_or_else(PoisonError::into_inner).push(Box::new(look));
    }

    /// Counts a gRPC call that is over.
    pub fn count_rpc(&self, method: &'static str, code: &'static str, took: Duration) {
        self.rpcs.get_or_create(&RpcLabels { method, code }).inc();
        self.rpc_seconds.get_or_create(&MethodLabel { method }).observe(took.as_secs_f64());
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
        self.looks.lock().unwrap_or_else(PoisonError::into_inner).iter().for_each(|look| look(&self.figures));
        let mut text = String::new();
        if let Err(error) = encode(&mut text, &self.registry) {
            tracing::error!(%error, "the metrics cannot be written down");
        }
        text
    }
}

/// From half a millisecond, the least that a call takes, to 8 minutes, the longest one.
fn call_seconds() -> Histogram {
    Histogram::new(exponential_buckets(0.000_5, 4.0, 11))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an older Prometheus that finds counters without a type, or takes the end for a line of its own.
    #[test]
    fn the_older_format_describes_each_sample_by_its_name() {
        let metrics = Metrics::default();
        metrics.built_from("a1b2");
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
        metrics.built_from("a1b2");
        metrics.fixes.get_or_create(&OutcomeLabel { outcome: "USABLE" }).inc();
        metrics.align_seconds.observe(0.01);
        let text = metrics.render();
        assert!(text.contains("echofix_fixes_total{outcome=\"USABLE\"} 1"), "{text}");
        assert!(text.contains("echofix_align_seconds_count 1"), "{text}");
        assert!(text.ends_with("# EOF\n"), "{text}");
    }

    /// All of it in the older format, each family with a sample.
    pub(crate) fn filled() -> String {
        let metrics = Metrics::default();
        metrics.built_from("a1b2");
        metrics.count_rpc("/echofix.v1.MapService/GetTiles", "OK", Duration::from_millis(3));
        metrics
            .http
            .get_or_create(&HttpLabels { method: "GET", route: "/healthz".to_owned(), status: 200 })
            .inc();
        metrics.http_seconds.get_or_create(&RouteLabel { route: "/healthz".to_owned() }).observe(0.01);
        let word = OutcomeLabel { outcome: "USABLE" };
        for family in
            [&metrics.fixes, &metrics.refused, &metrics.uploads, &metrics.windows, &metrics.confirmations]
        {
            family.get_or_create(&word).inc();
        }
        metrics.quarantined.get_or_create(&word).inc();
        metrics.webhook.get_or_create(&word).inc();
        metrics.refusals.get_or_create(&ReasonLabel { reason: "NO_MAP".to_owned() }).inc();
        metrics.connections.get_or_create(&PortLabel { port: "grpc" }).inc();
        metrics.connections_turned_away.get_or_create(&PortLabel { port: "grpc" }).inc();
        metrics.look_up(|figures| {
            figures.vetted.set("AGREES", 3);
            figures.tile_cache.set("hit", 1);
        });
        metrics.render_classic()
    }

    /// Catches: a dashboard or an alert that looks at a metric which the service does not have, and so never shows anything.
    #[test]
    fn dashboards_and_alerts_name_metrics_that_there_are() {
        let text = filled();
        let kinds = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split_once(' '));
        let mut known = std::collections::BTreeSet::new();
        for (name, kind) in kinds {
            known.insert(name.to_owned());
            if kind == "histogram" {
                known.extend(["_bucket", "_sum", "_count"].map(|end| format!("{name}{end}")));
            }
        }
        for (file, text, least) in [
            ("dashboard", include_str!("../../docker/monitoring/echofix-dashboard.json"), 20),
            ("alerts", include_str!("../../docker/monitoring/echofix-alerts.yaml"), 9),
        ] {
            let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
            let named = text
                .split(word)
                .filter(|name| ["echofix_", "process_"].iter().any(|prefix| name.starts_with(prefix)));
            let named: std::collections::BTreeSet<_> = named.collect();
            assert!(named.len() >= least, "{file}: {named:?}");
            for name in named {
                assert!(known.contains(name), "{file} names {name}");
            }
        }
        let dashboard = include_str!("../../docker/monitoring/echofix-dashboard.json");
        let dashboard: serde_json::Value = serde_json::from_str(dashboard).unwrap();
        assert!(dashboard["panels"].as_array().unwrap().len() > 10);
    }

    /// Catches: names that `promtool check metrics` finds fault with: counters without `_total`, others with it, no help, no base
    /// unit, and a family that is described twice.
    #[test]
    fn names_keep_to_prometheus_rules() {
        let text = filled();
        let described = |what: &str| -> Vec<(String, String)> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(what)?.split_once(' '));
            lines.map(|(name, rest)| (name.to_owned(), rest.to_owned())).collect()
        };
        let (kinds, helps) = (described("# TYPE "), described("# HELP "));
        assert!(kinds.len() > 35 && kinds.len() == helps.len(), "{} {}", kinds.len(), helps.len());
        for (name, kind) in &kinds {
            assert_eq!(name.ends_with("_total"), kind == "counter", "{name}: {kind}");
            assert!(kind == "histogram" || ["counter", "gauge"].contains(&&**kind), "{name}: {kind}");
            assert_eq!(kinds.iter().filter(|(other, _)| other == name).count(), 1, "{name}");
            let help = helps.iter().find(|(other, _)| other == name).map(|(_, help)| help);
            assert!(help.is_some_and(|help| help.len() > 8), "{name}: {help:?}");
            let plain = name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_');
            let own = name.starts_with("echofix_") || name.starts_with("process_");
            let ends = [
                "_bucket",
                "_count",
                "_sum",
                "_ms",
                "_milliseconds",
                "_minutes",
                "_days",
                "_kb",
                "_mib",
                "_info_total",
            ];
            assert!(plain && own && !ends.iter().any(|end| name.ends_with(end)), "{name}");
            assert!(kind != "histogram" || name.ends_with("_seconds"), "{name}");
        }
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let sample = line.split(['{', ' ']).next().unwrap();
            let of = |suffix: &str| sample.strip_suffix(suffix).unwrap_or(sample).to_owned();
            let known = [of(""), of("_bucket"), of("_sum"), of("_count")];
            assert!(kinds.iter().any(|(name, _)| known.contains(name)), "{line}");
        }
        assert!(text.contains("process_cpu_seconds_total ") && text.contains("process_open_fds "), "{text}");
        assert!(text.contains("echofix_vetted_uploads_total{outcome=\"AGREES\"} 3"), "{text}");
        assert!(text.contains("commit=\"a1b2\""), "{text}");
    }
}
