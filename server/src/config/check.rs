//! Values that would make no sense.

use tracing_subscriber::EnvFilter;

use super::{AlarmsConfig, Config, Error, HttpConfig, LimitsConfig, StoreConfig};
use crate::export::TraceConfig;
use crate::grpc::INTEGRITY_RISKS;
use crate::http::{is_base_map, is_base_path, is_origin};
use crate::identity::{self, RatesConfig};
use crate::listen::socket_mode;
use crate::locating::LocatingConfig;
use crate::mapping::MappingConfig;

/// A key, whether its value makes sense, and the rule.
type Rule = (&'static str, bool, &'static str);

const POSITIVE: &str = "must be above 0";
/// The longest time in seconds that any limit may be: more is no limit.
const DAY_S: u64 = 86_400;
/// Days that the map can count.
const MAX_DAYS: f64 = 65_535.0;

impl Config {
    pub(super) fn check(&self) -> Result<(), Error> {
        let sections = [
            ports(self),
            store(&self.store),
            locating(&self.locating, self.radar.max_range_m),
            mapping(&self.mapping),
            limits(&self.limits),
            alarms(&self.alarms),
            rates(self.rates),
            together(self),
            trace(&self.trace),
        ];
        if let Some((key, _, rule)) = sections.iter().flatten().find(|(_, holds, _)| !holds) {
            return Err(Error::OutOfRange { key, rule });
        }
        self.alarms.secret()?;
        identity::check(&self.tls, &self.identity, &[])?;
        let filter = EnvFilter::builder().parse(&self.log.filter);
        let refused = |error: &dyn std::fmt::Display| Error::Malformed {
            origin: "`log.filter`".to_owned(),
            reason: format!(
                "{error}; write a level, as `info`, or directives, as `echofix_server=debug,warn`"
            ),
        };
        filter.map_err(|error| refused(&error))?;
        // A directive without `=` that is no level is read as the name of a module, which nobody can mean.
        match self.log.filter.split(',').map(str::trim).find(|directive| !is_sane(directive)) {
            Some(directive) => Err(refused(&format!("`{directive}` is no directive"))),
            None => Ok(()),
        }
    }
}

/// Does a directive consist of what names of modules, spans, fields and levels consist of?
fn is_sane(directive: &str) -> bool {
    let known = |c: char| c.is_ascii_alphanumeric() || "_:-=.[]{}\"/\\* ".contains(c);
    !directive.is_empty()
        && directive.chars().all(known)
        && directive.chars().any(|c| c.is_ascii_alphanumeric())
}

fn within(value: f64, most: f64) -> bool {
    value > 0.0 && value <= most
}

fn trace(config: &TraceConfig) -> Vec<Rule> {
    let endpoint = config.endpoint();
    let address = endpoint.strip_prefix("http://").map(|rest| rest.trim_end_matches('/'));
    let sound =
        endpoint.is_empty() || address.is_some_and(|a| a.parse::<axum::http::uri::Authority>().is_ok());
    vec![(
        "trace.otlp_endpoint",
        sound,
        "be empty or as http://collector:4317 (also from OTEL_EXPORTER_OTLP_ENDPOINT); for https, send to a collector beside the \
         service",
    )]
}

fn ports(config: &Config) -> Vec<Rule> {
    let (grpc, HttpConfig { listen, socket_mode: mode, hosts, base_path, cors_origins, .. }) =
        (&config.grpc, &config.http);
    let apart = listen.is_apart_from(&grpc.listen);
    let rights = "must be the rights on the socket's file in octal digits, as 0600 or 0660";
    let name = |host: &String| {
        (1..=253).contains(&host.len())
            && host.chars().all(|c| c.is_ascii_alphanumeric() || "-._:[]".contains(c))
    };
    let bare = |host: &String| host.starts_with('[') || host.matches(':').count() != 1;
    vec![
        ("http.listen", apart, "must differ from grpc.listen: each port needs an address of its own"),
        ("grpc.socket_mode", socket_mode(&grpc.socket_mode).is_some(), rights),
        ("http.socket_mode", socket_mode(mode).is_some(), rights),
        (
            "http.hosts",
            hosts.iter().all(name),
            "must be names such as `maps.example.com`, without scheme and path",
        ),
        ("http.hosts", hosts.iter().all(bare), "must be names without a port: every port of a name is taken"),
        (
            "http.base_path",
            is_base_path(base_path),
            "must be empty or a path such as `/echofix`: with a slash before each part, and none at the end",
        ),
        (
            "http.cors_origins",
            cors_origins.iter().all(|origin| is_origin(origin)),
            "must be origins as browsers write them, such as `https://maps.example` or `http://localhost:3000`: in small \
             letters, without a path, a slash at the end or the scheme's own port; or `*`",
        ),
        (
            "http.base_map",
            is_base_map(&config.http.base_map),
            "must be empty, a template such as `https://tiles.example/{z}/{x}/{y}.png`, or a PMTiles file (version 3) that the \
             service can read",
        ),
        ("http.base_map_max_zoom", config.http.base_map_max_zoom <= 24, "must be at most 24"),
    ]
}

fn store(store: &StoreConfig) -> Vec<Rule> {
    let dir = store.data_dir.as_os_str();
    let named =
        !dir.is_empty() && dir.to_str().is_none_or(|dir| !dir.trim().is_empty() && !dir.contains('\0'));
    vec![
        (
            "store.url",
            store.place().is_some(),
            "must be empty, `file:` with a directory, or `s3://bucket/prefix`; credentials come from AWS_* in the environment",
        ),
        (
            "store.announce",
            store.announce.is_empty() || is_address(&store.announce),
            "must be empty, or `https://host:port` (`http://...` without TLS): where vehicles reach this service itself",
        ),
        (
            "store.announce",
            store.announce.is_empty() || store.bucket().is_some(),
            "needs a map that services share: set `store.url` to `s3://bucket/prefix`",
        ),
        ("store.data_dir", named, "is empty; name the directory that holds the map"),
        ("store.cache_mib", (1..=1 << 20).contains(&store.cache_mib), "must lie within 1 and 1048576"),
        ("store.segment_mib", (1..=1024).contains(&store.segment_mib), "must lie within 1 and 1024"),
    ]
}

/// A scheme, a host and a port, and nothing else.
fn is_address(text: &str) -> bool {
    let Ok(uri) = text.parse::<axum::http::Uri>() else { return false };
    let plain = uri.authority().is_some_and(|authority| !authority.as_str().contains('@'));
    let scheme = matches!(uri.scheme_str(), Some("http" | "https"));
    scheme
        && plain
        && uri.port_u16().is_some()
        && !text.ends_with('/')
        && uri.path() == "/"
        && uri.query().is_none()
}

fn locating(locating: &LocatingConfig, radar_range_m: f64) -> Vec<Rule> {
    vec![
        ("locating.threads", locating.threads <= 1024, "must be at most 1024"),
        ("locating.queue", locating.queue <= 4096, "must be at most 4096"),
        (
            "locating.tile_cache_mib",
            (1..=1 << 20).contains(&locating.tile_cache_mib),
            "must lie within 1 and 1048576",
        ),
        (
            "locating.stream_batches_mib",
            locating.stream_batches_mib <= 1 << 20,
            "must be at most 1048576; 0 keeps none",
        ),
        ("locating.confirm_share", (0.0..=1.0).contains(&locating.confirm_share), "must lie within 0 and 1"),
        (
            "locating.wide_search_m",
            (0.0..=100.0).contains(&locating.wide_search_m),
            "must lie within 0 and 100",
        ),
        (
            "locating.min_speed_mps",
            (0.0..=100.0).contains(&locating.min_speed_mps),
            "must be finite and not negative, and at most 100",
        ),
        ("radar.max_range_m", (1.0..=300.0).contains(&radar_range_m), "must lie within 1 and 300"),
        (
            "locating.max_range_m",
            (0.0..=300.0).contains(&locating.max_range_m),
            "must lie within 0 and 300; 0 takes radar.max_range_m",
        ),
        (
            "locating.max_doppler_residual_mps",
            within(locating.max_doppler_residual_mps, 1_000.0),
            "must be finite and above 0, and at most 1000",
        ),
        (
            "locating.min_detections",
            (1..=1_000_000).contains(&locating.min_detections),
            "must be above 0 and at most 1000000",
        ),
        (
            "locating.max_sigma_position_m",
            within(locating.max_sigma_position_m, 20.0),
            "must be above 0 and at most 20",
        ),
        (
            "locating.max_sigma_yaw_deg",
            within(locating.max_sigma_yaw_deg, 45.0),
            "must be above 0 and at most 45",
        ),
        (
            "locating.integrity_risk",
            INTEGRITY_RISKS.contains(&locating.integrity_risk),
            "must lie within 1e-9 and 0.1",
        ),
    ]
}

fn mapping(mapping: &MappingConfig) -> Vec<Rule> {
    let mut rules = poses_and_detections(mapping);
    rules.extend([
        ("mapping.publish_contributors", mapping.publish_contributors > 0, POSITIVE),
        ("mapping.vet_shift_m", within(mapping.vet_shift_m, 5.0), "must lie within 0 and 5"),
        ("mapping.vet_turn_deg", within(mapping.vet_turn_deg, 3.0), "must lie within 0 and 3"),
        (
            "mapping.half_life_days",
            within(mapping.half_life_days, MAX_DAYS),
            "must be above 0 and at most 65535",
        ),
        ("mapping.expire_days", mapping.expire_days > 0, POSITIVE),
        ages(mapping),
        (
            "mapping.max_upload_bytes",
            (1024..=1 << 30).contains(&mapping.max_upload_bytes),
            "must be at least 1024 and at most 1073741824",
        ),
        (
            "mapping.max_upload_detections",
            (1..=10_000_000).contains(&mapping.max_upload_detections),
            "must be above 0 and at most 10000000",
        ),
        (
            "mapping.max_upload_tiles",
            (1..=65_536).contains(&mapping.max_upload_tiles),
            "must be above 0 and at most 65536",
        ),
        (
            "mapping.uploads_at_once",
            (1..=256).contains(&mapping.uploads_at_once),
            "must lie within 1 and 256",
        ),
        (
            "mapping.max_unfolded",
            (1..=1_000_000_000).contains(&mapping.max_unfolded),
            "must be above 0 and at most 1000000000",
        ),
    ]);
    rules
}

fn poses_and_detections(mapping: &MappingConfig) -> Vec<Rule> {
    vec![
        (
            "mapping.max_sigma_position_m",
            within(mapping.max_sigma_position_m, 100.0),
            "must be above 0 and at most 100",
        ),
        (
            "mapping.max_sigma_yaw_deg",
            within(mapping.max_sigma_yaw_deg, 180.0),
            "must be above 0 and at most 180",
        ),
        (
            "mapping.min_speed_mps",
            (0.0..=100.0).contains(&mapping.min_speed_mps),
            "must not be negative, and be at most 100",
        ),
        (
            "mapping.max_range_m",
            (0.0..=500.0).contains(&mapping.max_range_m),
            "must lie within 0 and 500; 0 takes radar.max_range_m",
        ),
        (
            "mapping.max_doppler_residual_mps",
            within(mapping.max_doppler_residual_mps, 1_000.0),
            "must be above 0 and at most 1000",
        ),
        (
            "mapping.max_pose_gap_s",
            within(mapping.max_pose_gap_s, 3_600.0),
            "must be above 0 and at most 3600",
        ),
        ("mapping.max_speed_mps", within(mapping.max_speed_mps, 1_000.0), "must be above 0 and at most 1000"),
        ("mapping.max_speed_mps", mapping.max_speed_mps > mapping.min_speed_mps, "must exceed min_speed_mps"),
        ("mapping.refresh_days", (1..=365).contains(&mapping.refresh_days), "must be 1 to 365"),
    ]
}

/// Ids are forgotten with what is compacted: what comes again must be refused for its age by then.
fn ages(mapping: &MappingConfig) -> Rule {
    let holds = mapping.retention_days == 0 || mapping.max_age_days < mapping.retention_days;
    let rule = "must be less than mapping.retention_days: an upload sent again after that would count twice";
    ("mapping.max_age_days", holds, rule)
}

fn alarms(alarms: &AlarmsConfig) -> Vec<Rule> {
    let AlarmsConfig { contributors, within_m, shift_m, turn_deg, .. } = *alarms;
    let url =
        |text: &str| reqwest::Url::parse(text).ok().filter(|url| ["http", "https"].contains(&url.scheme()));
    let sound = |text: &str| text.is_empty() || url(text).is_some();
    let secret = !alarms.webhook_secret.as_os_str().is_empty();
    let kept = url(&alarms.webhook).is_some_and(|url| {
        url.scheme() == "https"
            || url.host_str().is_some_and(|host| ["localhost", "127.0.0.1", "[::1]"].contains(&host))
    });
    vec![
        ("alarms.contributors", contributors >= 2, "must be at least 2: one alone may just be wrong"),
        ("alarms.within_m", within(within_m, 10_000.0), "must be above 0 and at most 10000"),
        ("alarms.shift_m", within(shift_m, 100.0), "must be above 0 and at most 100"),
        ("alarms.turn_deg", within(turn_deg, 180.0), "must be above 0 and at most 180"),
        (
            "alarms.webhook",
            sound(&alarms.webhook),
            "must be empty, or a URL such as `https://alerts.example.com/echofix`",
        ),
        (
            "alarms.webhook_secret",
            !secret || kept,
            "needs an alarms.webhook of https, or of this machine: anybody could read it on the way",
        ),
        (
            "alarms.console",
            sound(&alarms.console),
            "must be empty, or the console's URL such as `https://maps.example.com`",
        ),
    ]
}

fn limits(limits: &LimitsConfig) -> Vec<Rule> {
    let seconds = |key, value: u64| (key, (1..=DAY_S).contains(&value), "must be above 0 and at most 86400");
    vec![
        (
            "limits.connections",
            (1..=1_000_000).contains(&limits.connections),
            "must be above 0 and at most 1000000",
        ),
        (
            "limits.streams_per_connection",
            (1..=65_536).contains(&limits.streams_per_connection),
            "must be above 0 and at most 65536",
        ),
        (
            "limits.message_bytes",
            (1024..=64 << 20).contains(&limits.message_bytes),
            "must lie within 1024 and 67108864",
        ),
        (
            "limits.header_bytes",
            (1024..=1 << 20).contains(&limits.header_bytes),
            "must be at least 1024 and at most 1048576",
        ),
        (
            "limits.resets_per_connection",
            limits.resets_per_connection <= 1_000_000,
            "must be at most 1000000",
        ),
        ("limits.reads_at_once", (1..=4096).contains(&limits.reads_at_once), "must lie within 1 and 4096"),
        ("limits.address_share", within(limits.address_share, 1.0), "must be above 0 and at most 1"),
        (
            "limits.least_bytes_per_s",
            (1..=1 << 20).contains(&limits.least_bytes_per_s),
            "must be above 0 and at most 1048576",
        ),
        seconds("limits.idle_s", limits.idle_s),
        seconds("limits.handshake_s", limits.handshake_s),
        seconds("limits.keepalive_s", limits.keepalive_s),
        seconds("limits.keepalive_timeout_s", limits.keepalive_timeout_s),
        seconds("limits.request_s", limits.request_s),
        seconds("limits.stall_s", limits.stall_s),
        ("limits.shutdown_s", limits.shutdown_s <= DAY_S, "must be at most 86400"),
    ]
}

fn rates(rates: RatesConfig) -> Vec<Rule> {
    let most = "must be at most 1000000; 0 is no limit";
    vec![
        ("rates.localize_per_s", rates.localize_per_s <= 1_000_000, most),
        ("rates.upload_per_min", rates.upload_per_min <= 1_000_000, most),
        ("rates.http_per_s", rates.http_per_s <= 1_000_000, most),
        ("rates.http_address_per_s", rates.http_address_per_s <= 1_000_000, most),
    ]
}

/// Values that make sense alone, and not beside another.
fn together(config: &Config) -> Vec<Rule> {
    let Config { limits, mapping, .. } = config;
    vec![
        (
            "limits.stall_s",
            limits.stall_s <= limits.request_s,
            "must be at most limits.request_s, which ends a silent request before",
        ),
        (
            "limits.header_bytes",
            limits.header_bytes as usize <= limits.message_bytes.max(16 << 10),
            "must be at most limits.message_bytes: headers are no place for data",
        ),
        (
            "mapping.max_upload_tiles",
            mapping.max_upload_tiles <= mapping.max_upload_detections.max(4096),
            "must be at most mapping.max_upload_detections: a tile has one detection at least",
        ),
    ]
}
