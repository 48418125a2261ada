//! What one of each thing costs, as it was measured.

use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};

/// The figures of `costs.toml`, which says where each comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Costs {
    pub fix_cpu_ms: f64,
    pub question_kb: f64,
    pub answer_kb: f64,
    pub cold_cpu_ms_a_km: f64,
    pub cold_window_ms: f64,
    pub process_mb: f64,
    pub prepared_mb_a_km: f64,
    pub upload_cpu_ms: f64,
    pub upload_kb: f64,
    pub append_ms: f64,
    pub map_mb_a_km: f64,
    pub disk_mb_a_encoded_mb: f64,
    pub index_bytes_an_upload: f64,
    pub core_hour: f64,
    pub gib_memory_hour: f64,
    pub gb_disk_month: f64,
    pub gb_bucket_month: f64,
    pub put_1000: f64,
    pub get_1000: f64,
    pub gb_to_vehicles: f64,
}

impl Costs {
    /// The figures of this repository, or those of a file.
    ///
    /// # Errors
    /// When the file cannot be read, or lacks a figure.
    pub fn read(file: Option<&Path>) -> anyhow::Result<Self> {
        let Some(file) = file else {
            return toml::from_str(include_str!("costs.toml")).context("reading costs.toml");
        };
        let text = std::fs::read_to_string(file).with_context(|| format!("reading {}", file.display()))?;
        toml::from_str(&text).with_context(|| format!("reading {}", file.display()))
    }

    /// Fixes that wait for a kilometre that is not prepared yet.
    pub fn cold_fixes_a_km(&self) -> f64 {
        self.cold_cpu_ms_a_km / self.cold_window_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a key that the file lost, and one that nobody reads.
    #[test]
    fn the_file_has_every_figure() {
        let costs = Costs::read(None).unwrap();
        assert!(costs.fix_cpu_ms > 0.0 && costs.cold_fixes_a_km() > 1.0);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("costs.toml");
        std::fs::write(&file, "fix_cpu_ms = 1.0\n").unwrap();
        let error = format!("{:#}", Costs::read(Some(&file)).unwrap_err());
        assert!(error.contains("question_kb"), "{error}");
    }
}
