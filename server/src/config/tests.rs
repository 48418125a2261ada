use super::*;

fn load(
    file: Option<&str>,
    environment: &[(&str, &str)],
    settings: &[(&str, &str)],
) -> Result<Config, Error> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("my.toml");
    std::fs::write(&path, file.unwrap_or_default()).unwrap();
    let owned =
        |pairs: &[(&str, &str)]| pairs.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    let file = file.map(|_| path);
    Config::load(&Sources { file, environment: owned(environment), settings: owned(settings) })
}

#[test]
fn the_shipped_file_is_the_default_and_sets_every_key() {
    let config = load(None, &[], &[]).unwrap();
    assert_eq!(config.grpc.listen.to_string(), "127.0.0.1:50051");
    assert_eq!(config.mapping, MappingConfig::default());
    let again: Config = toml::from_str(&config.to_toml()).unwrap();
    assert_eq!(again, config);
}

#[test]
fn uploads_may_stay_for_ever_or_longer_than_they_are_taken() {
    for mapping in ["max_age_days = 30\nretention_days = 31", "max_age_days = 365\nretention_days = 0"] {
        assert!(load(Some(&format!("[mapping]\n{mapping}")), &[], &[]).is_ok(), "{mapping}");
    }
}

#[test]
fn later_layers_win() {
    let file = Some("[http]\nlisten = \"0.0.0.0:1\"\n[mapping]\nmax_range_m = 60\nuploads_at_once = 2");
    let env = [
        ("ECHOFIX_HTTP_LISTEN", "0.0.0.0:2"),
        ("ECHOFIX_MAPPING_UPLOADS_AT_ONCE", "3"),
        ("ECHOFIX_SERVER", "x"),
    ];
    let config = load(file, &env, &[("http.listen", "0.0.0.0:3")]).unwrap();
    assert_eq!(config.http.listen.to_string(), "0.0.0.0:3");
    assert_eq!(config.mapping.uploads_at_once, 3);
    assert!((config.mapping.max_range_m - 60.0).abs() < 1e-12);
}

/// Catches a limit of the range that is set in one place and not honoured in another.
#[test]
fn one_key_limits_the_range_of_uploads_and_requests() {
    let ranges = |file: &str| {
        let config = load(Some(file), &[], &[]).unwrap();
        [
            config.mapping.limits().gate.max_range_m,
            config.locating.gate().max_range_m,
            config.locating.search().extent_m,
        ]
    };
    assert_eq!(ranges("").map(f64::to_bits), [50_f64; 3].map(f64::to_bits));
    assert_eq!(ranges("[radar]\nmax_range_m = 100").map(f64::to_bits), [100_f64; 3].map(f64::to_bits));
    let apart = ranges("[radar]\nmax_range_m = 100\n[mapping]\nmax_range_m = 60");
    assert_eq!(apart.map(f64::to_bits), [60_f64, 100.0, 100.0].map(f64::to_bits));
    let error = load(Some("[radar]\nmax_range_m = 0.5"), &[], &[]).unwrap_err().to_string();
    assert!(error.contains("`radar.max_range_m` must lie within 1 and 300"), "{error}");
}

#[test]
fn mistakes_are_reported_with_their_origin_and_a_hint() {
    let message = |file: &str| load(Some(file), &[], &[]).unwrap_err().to_string();
    let typo = message("[mapping]\nmax_rang_m = 60");
    assert!(typo.contains("my.toml") && typo.contains("did you mean `mapping.max_range_m`?"), "{typo}");
    let ages = "[mapping]\nmax_age_days = 30\nretention_days = 30";
    assert!(message(ages).contains("must be less than mapping.retention_days"), "{}", message(ages));
    assert!(message("[maping]\nmax_range_m = 60").contains("did you mean `mapping.max_range_m`?"));
    assert!(message("listen = 3").contains("unknown key `listen`"));
    assert!(message("[http]\nlisten = 3").contains("must be a string"));
    assert!(message("[http]\nlisten = \"here\"").contains("listen"));
    assert!(message("[http\n").contains("my.toml"));
    assert!(message("[store]\ntable = \"paper\"").contains("table"));
    assert!(message("[store]\nsegment_mib = 0").contains("`store.segment_mib` must lie within 1 and 1024"));
    let env = load(None, &[("ECHOFIX_LOG_FORMT", "json")], &[]).unwrap_err().to_string();
    assert!(env.contains("ECHOFIX_LOG_FORMT") && env.contains("`log.format`"), "{env}");
    let set = load(None, &[], &[("limits.stall", "3")]).unwrap_err().to_string();
    assert!(set.contains("did you mean `limits.stall_s`?"), "{set}");
    assert!(Config::load(&Sources { file: Some("/nowhere.toml".into()), ..Sources::default() }).is_err());
}

/// What is no number out of range.
const OTHERS: &[(&str, &str)] = &[
    ("limits.header_bytes", "4000000000"),
    ("limits.streams_per_connection", "4000000000"),
    ("limits.streams_per_connection", "0"),
    ("locating.integrity_risk", "0.999"),
    ("store.announce", "replica-0:50051"),
    ("store.announce", "https://replica-0"),
    ("store.announce", "https://replica-0:50051/"),
    // With nobody to tell it to.
    ("store.announce", "https://replica-0:50051"),
    ("store.url", "maps"),
    ("store.url", "s3://"),
    ("store.url", "s3:///prefix"),
    ("store.url", "file:"),
    ("store.data_dir", ""),
    ("store.data_dir", "  "),
    ("log.access", "yes"),
    ("log.filter", "%%%"),
    ("log.filter", "info,%%%"),
    ("log.filter", ""),
    ("log.filter", "echofix=loud"),
    ("http.listen", "127.0.0.1:50051"),
    ("http.hosts", "[\"http://maps.example.com\"]"),
    ("http.hosts", "[\"maps.example.com:80\"]"),
    ("http.hosts", "[\"\"]"),
    ("http.hosts", "[1]"),
    ("http.base_path", "echofix"),
    ("http.base_path", "/echofix/"),
    ("http.base_path", "//evil.example"),
    ("http.base_path", "/a/../b"),
    ("http.cors_origins", "[\"maps.example\"]"),
    ("http.cors_origins", "[\"https://maps.example/\"]"),
    ("http.cors_origins", "[\"null\"]"),
    ("http.cors_origins", "[\"*\", \"\"]"),
    ("http.base_map", "https://tiles.example/{z}.png"),
    ("http.base_map", "https://tiles.example;/{z}/{x}/{y}.png"),
    ("http.base_map", "/nowhere/town.pmtiles"),
    ("http.base_map_max_zoom", "25"),
    ("limits.stall_s", "601"),
    ("alarms.webhook", "alerts.example.com"),
    ("alarms.webhook", "ftp://alerts.example.com"),
    ("alarms.webhook_secret", "/nowhere/token"),
    ("alarms.console", "maps"),
];

/// Catches: a configuration that passes the check and fails the service, or makes a limit none.
#[test]
fn every_value_that_makes_no_sense_is_told_in_words() {
    let many = "100000000000000000";
    let numbers = [
        "store.cache_mib",
        "store.segment_mib",
        "mapping.max_upload_bytes",
        "mapping.max_upload_detections",
        "mapping.max_upload_tiles",
        "mapping.uploads_at_once",
        "mapping.max_unfolded",
        "locating.threads",
        "locating.queue",
        "locating.tile_cache_mib",
        "locating.stream_batches_mib",
        "locating.min_detections",
        "limits.connections",
        "limits.message_bytes",
        "limits.resets_per_connection",
        "limits.reads_at_once",
        "limits.handshake_s",
        "limits.keepalive_s",
        "limits.keepalive_timeout_s",
        "limits.request_s",
        "limits.stall_s",
        "limits.shutdown_s",
    ];
    let floats = [
        "radar.max_range_m",
        "mapping.max_sigma_position_m",
        "mapping.max_sigma_yaw_deg",
        "mapping.min_speed_mps",
        "mapping.max_range_m",
        "mapping.max_doppler_residual_mps",
        "mapping.max_pose_gap_s",
        "mapping.max_speed_mps",
        "mapping.vet_shift_m",
        "mapping.vet_turn_deg",
        "mapping.half_life_days",
        "locating.confirm_share",
        "locating.wide_search_m",
        "locating.min_speed_mps",
        "locating.max_range_m",
        "locating.integrity_risk",
        "locating.max_doppler_residual_mps",
        "locating.max_sigma_position_m",
        "locating.max_sigma_yaw_deg",
    ];
    let each = |keys: &[&'static str], value: &'static str| -> Vec<_> {
        keys.iter().map(|key| (*key, value)).collect()
    };
    let cases = [each(&numbers, many), each(&floats, "1e17"), each(&floats, "nan"), OTHERS.to_vec()].concat();
    for (key, value) in cases {
        let error = load(None, &[], &[(key, value)]).expect_err(&format!("{key} = {value}")).to_string();
        let (_, name) = key.split_once('.').unwrap();
        assert!(error.contains(name) && error.len() > key.len() + 10, "{key} = {value}: {error}");
    }
    for filter in
        ["info", "echofix_server=debug,warn", "off", "echofix_server::run[rpc{call}]=trace,h2=error"]
    {
        assert!(load(None, &[], &[("log.filter", filter)]).is_ok(), "{filter}");
    }
    let config = load(None, &[("ECHOFIX_HTTP_HOSTS", "[\"maps.example.com\"]")], &[]).unwrap();
    assert_eq!(config.http.hosts, ["maps.example.com"]);
}

/// Catches: a secret that is sent in the open, and one that is found to be none when the first alarm comes.
#[test]
fn the_secret_of_the_webhook_is_checked_with_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("token");
    let checked = |url: &str, token: &str| {
        std::fs::write(&file, token).unwrap();
        let file = file.to_str().unwrap();
        load(None, &[], &[("alarms.webhook", url), ("alarms.webhook_secret", file)])
    };
    let config = checked("https://alerts.example.com/x", "s3cret\n").unwrap();
    assert_eq!(config.alarms.secret().unwrap().unwrap(), "Bearer s3cret");
    assert!(checked("http://127.0.0.1:9/x", "s3cret").is_ok());
    for (url, token) in
        [("http://alerts.example.com", "s3cret"), ("https://a.example", ""), ("https://a.example", "a\nb")]
    {
        let error = checked(url, token).unwrap_err().to_string();
        assert!(error.contains("alarms.webhook_secret"), "{url}: {error}");
    }
}

/// Catches: a value of a setting that changes its name with the code's.
#[test]
fn the_words_that_settings_take_stay() {
    for (key, words) in
        [("locating.engine", &["auto", "fast", "bounded", "fft"][..]), ("log.format", &["text", "json"])]
    {
        for word in words {
            let config = load(None, &[], &[(key, word)]).unwrap();
            let (_, name) = key.split_once('.').unwrap();
            assert!(config.to_toml().contains(&format!("{name} = \"{word}\"")), "{word}");
        }
    }
}

#[test]
fn locating_beyond_reason_is_refused() {
    let cases = [
        ("threads", "1025"),
        ("queue", "4097"),
        ("tile_cache_mib", "0"),
        ("tile_cache_mib", "1048577"),
        ("stream_batches_mib", "1048577"),
        ("confirm_share", "1.1"),
        ("wide_search_m", "-1.0"),
        ("min_speed_mps", "-0.1"),
        ("min_speed_mps", "inf"),
        ("max_range_m", "-1.0"),
        ("max_range_m", "301.0"),
        ("max_doppler_residual_mps", "nan"),
        ("max_doppler_residual_mps", "inf"),
        ("min_detections", "0"),
        ("max_sigma_position_m", "20.5"),
        ("max_sigma_yaw_deg", "46.0"),
        ("integrity_risk", "0.0"),
        ("integrity_risk", "1.0"),
    ];
    for (key, value) in cases {
        let error = load(Some(&format!("[locating]\n{key} = {value}")), &[], &[]).unwrap_err().to_string();
        assert!(error.starts_with(&format!("`locating.{key}` must ")), "{value}: {error}");
    }
    assert!(load(Some("[locating]\nmin_speed_mps = 0.0\nqueue = 0"), &[], &[]).is_ok());
}
