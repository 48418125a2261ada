//! Where the issuer's keys come from: a file, or an address that is asked again.

use std::sync::{Mutex, PoisonError};

use reqwest::Url;
use tokio::sync::Notify;

/// What an address told last, and that somebody asks for more.
#[derive(Default)]
pub(in crate::identity) struct Source {
    last: Mutex<Vec<u8>>,
    wanted: Notify,
}

impl Source {
    /// The last good set; empty before there is one.
    pub(in crate::identity) fn last(&self) -> Vec<u8> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes a set that was fetched and checked.
    pub(in crate::identity) fn put(&self, bytes: Vec<u8>) {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = bytes;
    }

    /// Waits until a token came whose key is not known, if none came yet.
    pub(in crate::identity) async fn wanted(&self) {
        self.wanted.notified().await;
    }

    /// A token came whose key is not known.
    pub(in crate::identity) fn want(&self) {
        self.wanted.notify_one();
    }
}

/// Is it an address that keys may be fetched from? Readable on the way they could be exchanged.
pub(in crate::identity) fn is_address(text: &str) -> bool {
    let Ok(url) = Url::parse(text) else { return false };
    let host = url.host_str().unwrap_or_default();
    let here = host == "localhost"
        || host.trim_matches(['[', ']']).parse().is_ok_and(|ip: std::net::IpAddr| ip.is_loopback());
    url.scheme() == "https" || (url.scheme() == "http" && here)
}
