//! What of a configuration is not as it is shipped, in words that may be logged.

use toml::{Table, Value};

use super::{Config, Sources};

/// Parts of names of keys whose values are nobody's business.
const SECRET: [&str; 6] = ["secret", "token", "password", "credential", "webhook", "key"];

impl Config {
    /// The settings that differ from the defaults, as `section.key=value`. What may be secret is only said to be set.
    #[must_use]
    pub fn differences(&self) -> Vec<String> {
        let table = |config: &Self| Table::try_from(config).unwrap_or_default();
        // The shipped file is checked by tests: it always loads.
        let shipped = Self::load(&Sources::default()).map(|shipped| table(&shipped)).unwrap_or_default();
        let of_section = |(section, keys): (String, Value)| {
            let before = shipped.get(&section).and_then(Value::as_table).cloned().unwrap_or_default();
            let keys = keys.as_table().cloned().unwrap_or_default();
            let other = keys.into_iter().filter(move |(key, value)| before.get(key) != Some(value));
            other.map(move |(key, value)| format!("{section}.{key}={}", shown(&key, &value)))
        };
        table(self).into_iter().flat_map(of_section).collect()
    }
}

fn shown(key: &str, value: &Value) -> String {
    if SECRET.iter().any(|part| key.contains(part)) {
        return "(set)".to_owned();
    }
    match value {
        Value::String(text) => format!("{:?}", without_credentials(text)),
        Value::Array(items) => {
            let items: Vec<_> = items.iter().map(|item| shown(key, item)).collect();
            format!("[{}]", items.join(", "))
        }
        other => other.to_string(),
    }
}

/// An address without what may stand before its host, and behind its path.
#[must_use]
pub fn without_credentials(text: &str) -> String {
    let Some((scheme, rest)) = text.split_once("://") else { return text.to_owned() };
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    let (host, path) = rest.split_once('/').map_or((rest, None), |(host, path)| (host, Some(path)));
    let host = host.rsplit('@').next().unwrap_or_default();
    path.map_or_else(|| format!("{scheme}://{host}"), |path| format!("{scheme}://{host}/{path}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(settings: &[(&str, &str)]) -> Vec<String> {
        let settings = settings.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        Config::load(&Sources { settings, ..Sources::default() }).unwrap().differences()
    }

    /// Catches: a line that names what is as shipped, leaves out what is not, or tells a secret.
    #[test]
    fn only_what_differs_is_told_and_no_secret() {
        assert_eq!(set(&[]), Vec::<String>::new());
        assert_eq!(set(&[("radar.max_range_m", "50"), ("log.filter", "info")]), Vec::<String>::new());
        let told = set(&[
            ("http.hosts", "[\"maps.example\"]"),
            ("rates.localize_per_s", "7"),
            ("identity.tokens", "/run/secrets/tokens"),
        ]);
        assert_eq!(
            told,
            [r#"http.hosts=["maps.example"]"#, "identity.tokens=(set)", "rates.localize_per_s=7"]
        );
        for (url, told) in [
            ("s3://bucket/prefix", "s3://bucket/prefix"),
            ("https://user:pass@host:9/a@b?token=x#y", "https://host:9/a@b"),
            ("https://user@host", "https://host"),
            ("file:/srv/maps", "file:/srv/maps"),
        ] {
            assert_eq!(without_credentials(url), told);
        }
    }
}
