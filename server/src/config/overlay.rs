//! Layers of TOML. The defaults are also the schema: a key they lack is unknown, and a value must
//! be of their kind.

use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::Error;

const PREFIX: &str = "ECHOFIX_";

/// The defaults with whatever was laid over them.
pub(super) struct Layered {
    table: Table,
}

impl Layered {
    pub(super) fn new(defaults: &str) -> Result<Self, Error> {
        let table = defaults.parse().map_err(|e: toml::de::Error| malformed("the defaults", &e))?;
        Ok(Self { table })
    }

    /// Lays a file's text over it.
    pub(super) fn file(&mut self, text: &str, origin: &str) -> Result<(), Error> {
        let file: Table = text.parse().map_err(|e: toml::de::Error| malformed(origin, &e))?;
        for (section, value) in file {
            let Value::Table(keys) = value else {
                return Err(self.unknown(&section, origin));
            };
            for (key, value) in keys {
                self.put(&format!("{section}.{key}"), value, origin)?;
            }
        }
        Ok(())
    }

    /// Lays variables `ECHOFIX_<SECTION>_<KEY>` over it; others are ignored.
    pub(super) fn environment(&mut self, variables: &[(String, String)]) -> Result<(), Error> {
        for (name, text) in variables {
            let Some(rest) = name.strip_prefix(PREFIX) else { continue };
            let rest = rest.to_lowercase();
            let Some((section, key)) = rest.split_once('_') else { continue };
            if self.table.contains_key(section) {
                self.set(&format!("{section}.{key}"), text, name)?;
            }
        }
        Ok(())
    }

    /// Lays `section.key = text` over it; the text needs no quotes where a string is expected.
    pub(super) fn set(&mut self, path: &str, text: &str, origin: &str) -> Result<(), Error> {
        let known = self.slot(path).ok_or_else(|| self.unknown(path, origin))?;
        let value = if known.is_str() {
            Value::String(text.to_owned())
        } else {
            let table: Table =
                format!("value = {text}").parse().map_err(|e: toml::de::Error| malformed(origin, &e))?;
            table.get("value").cloned().unwrap_or(Value::Boolean(false))
        };
        self.put(path, value, origin)
    }

    /// The layers as a value.
    pub(super) fn read<T: DeserializeOwned>(self) -> Result<T, Error> {
        Value::Table(self.table).try_into().map_err(|e: toml::de::Error| malformed("the configuration", &e))
    }

    fn put(&mut self, path: &str, value: Value, origin: &str) -> Result<(), Error> {
        let known = self.slot(path).ok_or_else(|| self.unknown(path, origin))?;
        // `50` is as good as `50.0`.
        let value = match (known, value) {
            (Value::Float(_), Value::Integer(whole)) => Value::Float(whole as f64),
            (_, value) => value,
        };
        if !known.same_type(&value) {
            let reason = format!("`{path}` must be a {}, as in `{path} = {known}`", known.type_str());
            return Err(Error::Malformed { origin: origin.to_owned(), reason });
        }
        let (section, key) = path.split_once('.').unwrap_or((path, ""));
        if let Some(Value::Table(keys)) = self.table.get_mut(section) {
            keys.insert(key.to_owned(), value);
        }
        Ok(())
    }

    fn slot(&self, path: &str) -> Option<&Value> {
        let (section, key) = path.split_once('.')?;
        self.table.get(section)?.get(key)
    }

    fn unknown(&self, path: &str, origin: &str) -> Error {
        let keys = self.table.iter().flat_map(|(section, keys)| {
            let keys = keys.as_table().into_iter().flat_map(Table::keys);
            keys.map(move |key| format!("{section}.{key}"))
        });
        let near = keys.map(|key| (strsim::jaro_winkler(&key, path), key));
        let best = near.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(likeness, _)| *likeness > 0.8);
        let hint = best.map_or_else(String::new, |(_, key)| format!("; did you mean `{key}`?"));
        Error::UnknownKey { origin: origin.to_owned(), key: path.to_owned(), hint }
    }
}

fn malformed(origin: &str, error: &toml::de::Error) -> Error {
    Error::Malformed { origin: origin.to_owned(), reason: error.to_string() }
}
