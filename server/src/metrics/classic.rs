//! Prometheus' text format of before OpenMetrics.

use std::collections::HashMap;

/// OpenMetrics text in the format of before it: a counter is described under the name of its sample, and there are neither
/// units nor an end.
pub(super) fn classic(text: &str) -> String {
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
