//! The figures of the demo, beside the paper's.

use echofix_harness::percentiles::{PAPER_95, Percentiles};
use echofix_harness::process::ServiceProcess;
use echofix_harness::summary::FixSummary;
use echofix_sim::City;
use serde_json::Value;

use super::{Args, Mapped};

/// What the demo measured.
pub(super) struct Report<'a> {
    pub(super) city: &'a City,
    pub(super) args: &'a Args,
    pub(super) mapped: Mapped,
    pub(super) map: Value,
    pub(super) summary: FixSummary,
    pub(super) seconds: f64,
}

impl Report<'_> {
    pub(super) fn print(&self, service: &ServiceProcess, json: bool) {
        let street_km = self.city.streets_m() / 1e3;
        let map_kb_per_km = self.map["totals"]["bytes"].as_f64().unwrap_or(f64::NAN) / 1e3 / street_km;
        if json {
            let report = serde_json::json!({
                "seed": self.args.seed, "contributors": self.args.contributors, "street_km": street_km,
                "driven_km": self.mapped.kilometres, "detections": self.mapped.detections, "upload_bytes": self.mapped.bytes,
                "uploads": self.mapped.uploads, "map": self.map, "map_kb_per_km": map_kb_per_km,
                "localizing": self.summary, "seconds": self.seconds, "console": service.http,
            });
            println!("{report}");
            return;
        }
        let Mapped { kilometres, detections, bytes, uploads } = &self.mapped;
        let kb_per_km = *bytes as f64 / 1000.0 / kilometres.max(f64::MIN_POSITIVE);
        println!(
            "\n{} vehicles drove {kilometres:.1} km and sent evidence of {detections} detections in {uploads} uploads, {kb_per_km:.0} kB a km.",
            self.args.contributors
        );
        println!(
            "Three days later, with other cars parked, another vehicle asked from priors of sigma 2 m and 3 deg:\n"
        );
        table(&self.summary);
        println!(
            "\nmap                  {map_kb_per_km:8.0} kB a street km, {} tiles",
            self.map["totals"]["tiles"]
        );
        println!("time                 {:8.0} s in all, town seed {}", self.seconds, self.args.seed);
        println!("console              {}", service.http);
    }
}

/// Prints the figures beside the paper's.
fn table(summary: &FixSummary) {
    let row = |name: &str, unit: &str, p: Option<Percentiles>, scale: f64, paper: String| {
        if let Some(Percentiles { p50, p95, p99 }) = p {
            let [p50, p95, p99] = [p50, p95, p99].map(|v| v * scale);
            println!("{name:<20} {unit:<4} {p50:8.2} {p95:8.2} {p99:8.2}   {paper}");
        }
    };
    println!("{:<25} {:>8} {:>8} {:>8}   the paper's 95 %", "", "50 %", "95 %", "99 %");
    let (paper_m, paper_deg) = PAPER_95;
    row("horizontal error", "cm", summary.error_all_m, 100.0, format!("{:.0} cm", paper_m * 100.0));
    row("heading error", "deg", summary.error_yaw_all_deg, 1.0, format!("{paper_deg} deg"));
    row("  of usable answers", "cm", summary.error_m, 100.0, String::new());
    row("  of usable answers", "deg", summary.error_yaw_deg, 1.0, String::new());
    row("a fix on the server", "ms", summary.server_ms, 1.0, String::new());
    row("a fix on the wire", "kB", summary.request_kb, 1.0, String::new());
    let usable = summary.usable_share * 100.0;
    println!(
        "\nanswers              {:8} asked, {usable:.1} % usable: {:?}",
        summary.asked, summary.outcomes
    );
    println!("beyond protection    {:8} of the usable answers, heading included", summary.beyond_protection);
    println!("not asked            {:?} (standing: radar at rest is mostly clutter)", summary.not_asked);
}
