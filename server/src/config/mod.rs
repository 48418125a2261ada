//! The configuration: `echofix.toml` is the embedded default; a file, the environment and flags
//! overlay it, the last one winning. Unknown keys are an error with a hint.

mod check;
mod differences;
mod overlay;

use std::path::PathBuf;
use std::time::Duration;

use axum::http::HeaderValue;
use echofix_core::vetting::alarm::AlarmLimits;
use serde::{Deserialize, Serialize};

use crate::export::TraceConfig;
use crate::identity::{self, Gate, IdentityConfig, RatesConfig, TlsConfig};
use crate::listen::ListenAddress;
use crate::locating::LocatingConfig;
use crate::mapping::MappingConfig;
use crate::pace::Pace;
use crate::store::TableEngine;
pub use differences::without_credentials;
use overlay::Layered;

/// The shipped file: every key, its default and its meaning.
pub const DEFAULTS: &str = include_str!("../../echofix.toml");

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file that was named by `--config`.
        path: PathBuf,
        /// What the operating system reported.
        source: std::io::Error,
    },
    /// Not TOML, or a value of the wrong kind.
    #[error("{origin}: {reason}")]
    Malformed {
        /// The file, environment variable or flag it came from.
        origin: String,
        /// What the parser reported.
        reason: String,
    },
    /// A key that the shipped file does not have.
    #[error("{origin}: unknown key `{key}`{hint}")]
    UnknownKey {
        /// The file, environment variable or flag it came from.
        origin: String,
        /// The key, with its section.
        key: String,
        /// What may have been meant.
        hint: String,
    },
    /// Nobody can be let in as configured.
    #[error(transparent)]
    Identity(#[from] identity::Error),
    /// A value outside its range.
    #[error("`{key}` {rule}")]
    OutOfRange {
        /// The key, with its section.
        key: &'static str,
        /// The rule that the value breaks.
        rule: &'static str,
    },
}

impl Error {
    /// Is it that nothing says who may do what, on a port that others reach? The program's exit code tells it apart.
    #[must_use]
    pub fn is_missing_identity(&self) -> bool {
        matches!(self, Self::Identity(error) if error.is_missing())
    }
}

/// Everything that can be configured; `echofix.toml` documents each key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The gRPC port, for vehicles.
    pub grpc: ListenConfig,
    /// The HTTP port, for operators.
    pub http: HttpConfig,
    /// What encrypts both ports.
    pub tls: TlsConfig,
    /// Who is let in.
    pub identity: IdentityConfig,
    /// How often one caller may ask.
    pub rates: RatesConfig,
    /// The data directory and its sizes.
    pub store: StoreConfig,
    /// What holds for uploads and requests alike.
    pub radar: RadarConfig,
    /// What an upload must fulfil.
    pub mapping: MappingConfig,
    /// How fixes are computed.
    pub locating: LocatingConfig,
    /// What one client may take of the service.
    pub limits: LimitsConfig,
    /// When operators are alarmed.
    pub alarms: AlarmsConfig,
    /// Where spans of calls are sent.
    pub trace: TraceConfig,
    /// What is written to standard error.
    pub log: LogConfig,
}

/// The address of a port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ListenConfig {
    /// Address and port, or a unix socket; port 0 takes any free one.
    pub listen: ListenAddress,
    /// The rights on that socket's file, as `0600`.
    pub socket_mode: String,
}

/// The operators' port.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HttpConfig {
    /// Address and port, or a unix socket; port 0 takes any free one.
    pub listen: ListenAddress,
    /// The rights on that socket's file, as `0600`.
    pub socket_mode: String,
    /// Names by which the port is reached, besides its address and `localhost`.
    pub hosts: Vec<String>,
    /// The path under which proxies show the port: empty, or as `/echofix`.
    pub base_path: String,
    /// Other origins whose pages may ask, as `https://maps.example`; `*` for what viewers read.
    pub cors_origins: Vec<String>,
    /// The map of streets that the console shows: none when empty, the template of tiles' addresses, or a `PMTiles` file.
    pub base_map: String,
    /// Whose map that is, as its licence asks.
    pub base_map_attribution: String,
    /// The last zoom that the tiles have.
    pub base_map_max_zoom: u8,
}

/// When quarantined uploads make an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlarmsConfig {
    /// Distinct contributors, at least.
    pub contributors: usize,
    /// Distance within which they lie, metres.
    pub within_m: f64,
    /// By how much their shifts differ at most, metres.
    pub shift_m: f64,
    /// By how much their turns differ at most, degrees.
    pub turn_deg: f64,
    /// Where new alarms are sent to; nowhere when empty.
    pub webhook: String,
    /// The file with the bearer token that goes with them; none when empty.
    pub webhook_secret: PathBuf,
    /// The console's address, as messages name it; none when empty.
    pub console: String,
}

impl AlarmsConfig {
    /// The same for those who compute.
    #[must_use]
    pub fn limits(&self) -> AlarmLimits {
        let Self { contributors, within_m, shift_m, turn_deg, .. } = *self;
        AlarmLimits { contributors, within_m, shift_m, yaw_rad: turn_deg.to_radians() }
    }

    /// The header that goes with what is sent to the webhook: the bearer token of the file. Reads it.
    ///
    /// # Errors
    /// When the file cannot be read, or does not hold one line that a header can be.
    pub fn secret(&self) -> Result<Option<HeaderValue>, Error> {
        if self.webhook_secret.as_os_str().is_empty() {
            return Ok(None);
        }
        let path = self.webhook_secret.clone();
        let text = std::fs::read_to_string(&path).map_err(|source| Error::Read { path, source })?;
        let token = text.trim();
        let wrong = Error::OutOfRange {
            key: "alarms.webhook_secret",
            rule: "must name a file with one line: the token, without `Bearer`",
        };
        let mut value = match HeaderValue::from_str(&format!("Bearer {token}")) {
            Ok(value) if !token.is_empty() && !token.contains(' ') => value,
            _ => return Err(wrong),
        };
        value.set_sensitive(true);
        Ok(Some(value))
    }
}

/// Where and how data is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoreConfig {
    /// Where the map is stored: nothing for the data directory, `file:` and another one, or `s3://bucket/prefix`.
    pub url: String,
    /// Where vehicles reach this service itself, which others that share its map may tell them; nowhere when empty.
    pub announce: String,
    /// The data directory; of a map in a bucket, its copy.
    pub data_dir: PathBuf,
    /// What tiles are stored in.
    pub table: TableEngine,
    /// Memory for the tile store's cache, MiB.
    pub cache_mib: u64,
    /// Size from which a journal segment is followed by the next, MiB.
    pub segment_mib: u64,
}

/// Where a map is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StorePlace {
    /// In a directory, which one service has for itself.
    Directory(PathBuf),
    /// In a bucket, which several services share; the data directory is a copy.
    Bucket(String),
}

impl StoreConfig {
    /// Where the map is stored; `None` when `url` is none of what it may be.
    #[must_use]
    pub fn place(&self) -> Option<StorePlace> {
        if self.url.is_empty() {
            return Some(StorePlace::Directory(self.data_dir.clone()));
        }
        if let Some(dir) = self.url.strip_prefix("file:") {
            let dir = dir.strip_prefix("//").unwrap_or(dir);
            return (!dir.trim().is_empty()).then(|| StorePlace::Directory(dir.into()));
        }
        let bucket = self.url.strip_prefix("s3://")?.split('/').next()?;
        let sound = bucket.len() >= 3
            && bucket.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte));
        sound.then(|| StorePlace::Bucket(self.url.clone()))
    }

    /// This service's own directory: the map's, or that of its copy of what is in a bucket.
    #[must_use]
    pub fn directory(&self) -> PathBuf {
        match self.place() {
            Some(StorePlace::Directory(dir)) => dir,
            // Without a place the configuration is refused.
            Some(StorePlace::Bucket(_)) | None => self.data_dir.clone(),
        }
    }

    /// The address that is announced, where there is one.
    #[must_use]
    pub fn announced(&self) -> Option<String> {
        (!self.announce.is_empty()).then(|| self.announce.clone())
    }

    /// The bucket that services share, where the map is stored in one.
    #[must_use]
    pub fn bucket(&self) -> Option<String> {
        match self.place() {
            Some(StorePlace::Bucket(url)) => Some(url),
            Some(StorePlace::Directory(_)) | None => None,
        }
    }
}

/// What holds for uploads and requests alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RadarConfig {
    /// Farther detections are left out, metres; and how far the map is read around a prior.
    pub max_range_m: f64,
}

/// What one client may take of the service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitsConfig {
    /// Connections to each port.
    pub connections: usize,
    /// Requests at once on one gRPC connection.
    pub streams_per_connection: u32,
    /// Bytes of one gRPC message, received and unpacked.
    pub message_bytes: usize,
    /// Bytes of the headers of one request.
    pub header_bytes: u32,
    /// Reset streams of one connection before it is closed.
    pub resets_per_connection: usize,
    /// Requests that read tiles at once.
    pub reads_at_once: usize,
    /// The part of what is bounded that one address may have, 0 to 1.
    pub address_share: f64,
    /// Until a connection's first request, seconds.
    pub handshake_s: u64,
    /// Between pings on a silent gRPC connection, seconds.
    pub keepalive_s: u64,
    /// Until a ping must be answered, seconds.
    pub keepalive_timeout_s: u64,
    /// Until a gRPC request ends, seconds.
    pub request_s: u64,
    /// Silence in the middle of a request, seconds.
    pub stall_s: u64,
    /// Bytes of a request a second, over longer times.
    pub least_bytes_per_s: u64,
    /// Until a connection without a call is closed, seconds.
    pub idle_s: u64,
    /// Requests in flight at the end, seconds.
    pub shutdown_s: u64,
}

impl LimitsConfig {
    /// How slowly a caller may send.
    #[must_use]
    pub fn pace(&self) -> Pace {
        Pace { stall: Duration::from_secs(self.stall_s), least_per_s: self.least_bytes_per_s }
    }

    /// Until a connection without a call is closed.
    #[must_use]
    pub fn idle(&self) -> Duration {
        Duration::from_secs(self.idle_s)
    }

    /// Between pings on a silent connection.
    #[must_use]
    pub fn keepalive(&self) -> Duration {
        Duration::from_secs(self.keepalive_s)
    }

    /// Until a ping must be answered.
    #[must_use]
    pub fn keepalive_timeout(&self) -> Duration {
        Duration::from_secs(self.keepalive_timeout_s)
    }

    /// Until a connection's first request.
    #[must_use]
    pub fn handshake(&self) -> Duration {
        Duration::from_secs(self.handshake_s)
    }
}

/// What is written to standard error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogConfig {
    /// For people or for machines.
    pub format: LogFormat,
    /// Which events, as `tracing-subscriber` understands it.
    pub filter: String,
    /// Whether each call has a line, with the target `access`.
    pub access: bool,
}

/// The look of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum LogFormat {
    /// Lines for people.
    #[serde(rename = "text")]
    Text,
    /// One JSON object a line, for machines.
    #[serde(rename = "json")]
    Json,
}

/// Where a configuration comes from, beside the defaults.
#[derive(Debug, Clone, Default)]
pub struct Sources {
    /// A file with the keys it changes.
    pub file: Option<PathBuf>,
    /// Environment variables; those named `ECHOFIX_<SECTION>_<KEY>` count.
    pub environment: Vec<(String, String)>,
    /// `section.key` and its value, as given by flags.
    pub settings: Vec<(String, String)>,
}

impl Config {
    /// The defaults, overlaid by the sources and checked.
    ///
    /// # Errors
    /// The first key that is unknown, of the wrong kind, or out of range, and where it was found.
    pub fn load(sources: &Sources) -> Result<Self, Error> {
        let mut layers = Layered::new(DEFAULTS)?;
        if let Some(path) = &sources.file {
            let read = |source| Error::Read { path: path.clone(), source };
            layers.file(&std::fs::read_to_string(path).map_err(read)?, &path.display().to_string())?;
        }
        layers.environment(&sources.environment)?;
        for (key, value) in &sources.settings {
            layers.set(key, value, &format!("--set {key}"))?;
        }
        let mut config: Self = layers.read()?;
        config.check()?;
        let Self { radar, mapping, locating, .. } = &mut config;
        for max_range_m in [&mut mapping.max_range_m, &mut locating.max_range_m] {
            if *max_range_m <= 0.0 {
                *max_range_m = radar.max_range_m;
            }
        }
        Ok(config)
    }

    /// Who is let in, for the ports of this configuration. Reads the files that it names.
    ///
    /// # Errors
    /// When others reach a port and nobody is asked, or a file cannot be used.
    pub fn gate(&self) -> Result<Gate, identity::Error> {
        Gate::of(&self.tls, &self.identity, &[self.grpc.listen.clone(), self.http.listen.clone()])
    }

    /// The configuration in force, as TOML.
    #[must_use]
    pub fn to_toml(&self) -> String {
        // Every value is a number, a string or a table of these.
        toml::to_string_pretty(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests;
