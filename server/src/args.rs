//! The command line of the service.

use std::path::PathBuf;

use clap::Args;

use crate::config::{Config, Error, Sources};
use crate::listen::ListenAddress;

/// The service's command line.
#[derive(Debug, Clone, Default, Args)]
pub struct ServeArgs {
    /// File with the configuration keys to change; without it the defaults hold
    #[arg(long, value_name = "PATH", env = "ECHOFIX_CONFIG")]
    pub config: Option<PathBuf>,
    /// Where to keep everything; overrides `store.data_dir`
    #[arg(long, value_name = "DIR")]
    pub data_dir: Option<PathBuf>,
    /// Where vehicles connect; overrides `grpc.listen`
    #[arg(long, value_name = "ADDRESS:PORT|unix:PATH")]
    pub grpc_listen: Option<ListenAddress>,
    /// Where operators connect; overrides `http.listen`
    #[arg(long, value_name = "ADDRESS:PORT|unix:PATH")]
    pub http_listen: Option<ListenAddress>,
    /// Overrides any key, for instance `--set mapping.max_range_m=60`; may be repeated
    #[arg(long = "set", value_name = "SECTION.KEY=VALUE", value_parser = key_and_value)]
    pub settings: Vec<(String, String)>,
    /// What callers may do whom nothing identifies: some of vehicle, mapper, viewer, operator, with commas between, or none;
    /// overrides `identity.anonymous`
    #[arg(long, value_name = "ROLES")]
    pub anonymous: Option<String>,
    /// Write the addresses in use to this file, as JSON
    #[arg(long, value_name = "PATH")]
    pub addr_file: Option<PathBuf>,
    /// Check the configuration and end
    #[arg(long)]
    pub check_config: bool,
    /// Print the configuration in force and end
    #[arg(long, conflicts_with = "check_config")]
    pub print_config: bool,
}

impl ServeArgs {
    /// The configuration in force: defaults, file, environment, flags.
    ///
    /// # Errors
    /// The first key that is unknown, of the wrong kind, or out of range, and where it was found.
    pub fn config(&self) -> Result<Config, Error> {
        let mut settings = self.settings.clone();
        let mut set = |key: &str, value: Option<String>| settings.extend(value.map(|v| (key.to_owned(), v)));
        set("store.data_dir", self.data_dir.as_ref().map(|dir| dir.display().to_string()));
        set("grpc.listen", self.grpc_listen.as_ref().map(ToString::to_string));
        set("http.listen", self.http_listen.as_ref().map(ToString::to_string));
        set("identity.anonymous", self.anonymous.clone());
        // Variables that are not Unicode cannot be ours.
        let text = |(k, v): (std::ffi::OsString, std::ffi::OsString)| {
            Some((k.into_string().ok()?, v.into_string().ok()?))
        };
        let environment = std::env::vars_os().filter_map(text).collect();
        Config::load(&Sources { file: self.config.clone(), environment, settings })
    }

    /// What to print instead of serving, where only the configuration is asked for. For serving and checking, what it names
    /// is read and checked, too.
    ///
    /// # Errors
    /// When nobody can be let in as configured.
    pub fn instead_of_serving(&self, config: &Config) -> Result<Option<String>, Error> {
        if self.print_config {
            return Ok(Some(config.to_toml()));
        }
        config.gate()?;
        Ok(self.check_config.then(String::new))
    }
}

/// A setting that is not written as one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected SECTION.KEY=VALUE")]
pub struct SettingError;

/// The key and the value of a setting.
///
/// # Errors
/// What was expected, where there is no equals sign.
pub fn key_and_value(text: &str) -> Result<(String, String), SettingError> {
    let (key, value) = text.split_once('=').ok_or(SettingError)?;
    Ok((key.trim().to_owned(), value.trim().to_owned()))
}
