//! Where a port listens, and where a connection comes from: over the network, or by a unix socket of this machine.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// How the address of a unix socket begins.
const UNIX: &str = "unix:";

/// Where a port listens.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ListenAddress {
    /// Address and port; port 0 takes any free one.
    Tcp(SocketAddr),
    /// The file of a unix socket.
    Unix(PathBuf),
}

/// A text that is no address to listen at.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no address to listen at; write address and port, as 127.0.0.1:8080, or unix: and a whole path, as unix:/run/echofix/http"
)]
pub struct NoAddress(String);

impl ListenAddress {
    /// Whether only this machine reaches it.
    #[must_use]
    pub fn is_local(&self) -> bool {
        match self {
            Self::Tcp(address) => address.ip().to_canonical().is_loopback(),
            Self::Unix(_) => true,
        }
    }

    /// Whether two ports can have these addresses at the same time.
    #[must_use]
    pub fn is_apart_from(&self, other: &Self) -> bool {
        self != other || matches!(self, Self::Tcp(address) if address.port() == 0)
    }

    /// The address that requests may name instead of a host: this machine's, for a unix socket.
    #[must_use]
    pub fn ip(&self) -> IpAddr {
        match self {
            Self::Tcp(address) => address.ip(),
            Self::Unix(_) => Ipv4Addr::LOCALHOST.into(),
        }
    }
}

impl FromStr for ListenAddress {
    type Err = NoAddress;

    fn from_str(text: &str) -> Result<Self, NoAddress> {
        let no_address = || NoAddress(text.to_owned());
        let Some(path) = text.strip_prefix(UNIX) else {
            return text.parse().map(Self::Tcp).map_err(|_| no_address());
        };
        // Clients write unix:/path and unix:///path alike.
        let path = Path::new(path.strip_prefix("//").unwrap_or(path));
        let whole = path.is_absolute() && path.file_name().is_some() && !text.contains('\0');
        if whole { Ok(Self::Unix(path.to_owned())) } else { Err(no_address()) }
    }
}

impl TryFrom<String> for ListenAddress {
    type Error = NoAddress;

    fn try_from(text: String) -> Result<Self, NoAddress> {
        text.parse()
    }
}

impl From<ListenAddress> for String {
    fn from(address: ListenAddress) -> Self {
        address.to_string()
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

/// The rights on a socket's file, as people write them: three or four octal digits.
#[must_use]
pub fn socket_mode(text: &str) -> Option<u32> {
    let digits = (3..=4).contains(&text.len()) && text.bytes().all(|b| b.is_ascii_digit());
    u32::from_str_radix(text, 8).ok().filter(|mode| digits && *mode <= 0o777)
}

/// Where a connection comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RemoteAddress {
    /// An address of the network, or of this machine.
    Ip(IpAddr),
    /// A unix socket.
    Unix,
}

impl RemoteAddress {
    /// Whether it is on this machine.
    #[must_use]
    pub fn is_local(self) -> bool {
        match self {
            Self::Ip(address) => address.to_canonical().is_loopback(),
            Self::Unix => true,
        }
    }

    /// The address by which callers are counted: a unix socket's are this machine's.
    #[must_use]
    pub fn ip(self) -> IpAddr {
        match self {
            Self::Ip(address) => address,
            Self::Unix => Ipv4Addr::LOCALHOST.into(),
        }
    }
}

impl fmt::Display for RemoteAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ip(address) => address.fmt(f),
            Self::Unix => f.write_str("a unix socket"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_shown() {
        for (text, local) in
            [("127.0.0.1:1", true), ("0.0.0.0:1", false), ("[::1]:1", true), ("unix:/run/a", true)]
        {
            let address: ListenAddress = text.parse().unwrap();
            assert_eq!((address.to_string().as_str(), address.is_local()), (text, local));
        }
        assert_eq!("unix:///run/a".parse(), Ok(ListenAddress::Unix("/run/a".into())));
        for text in ["", "here", "unix:", "unix:a", "unix:/", "unix://run/..", "unix:./a", "127.0.0.1"] {
            assert!(text.parse::<ListenAddress>().is_err(), "{text}");
        }
    }

    #[test]
    fn rights_are_octal() {
        assert_eq!((socket_mode("0600"), socket_mode("660")), (Some(0o600), Some(0o660)));
        for text in ["", "600 ", "rw", "0o600", "0888", "7777", "60", "-600", "+600"] {
            assert_eq!(socket_mode(text), None, "{text}");
        }
    }
}
