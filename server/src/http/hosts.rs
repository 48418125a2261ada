//! Which names the port answers to.

use std::net::IpAddr;

/// The names that the port answers to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hosts(Option<(IpAddr, Vec<String>)>);

impl Hosts {
    /// Of a port at an address, with names that lead to it besides.
    #[must_use]
    pub fn of(bound: IpAddr, names: &[String]) -> Self {
        Self(Some((bound, names.iter().map(|name| bare(name).to_ascii_lowercase()).collect())))
    }

    /// Whatever name: for routes without a port.
    #[must_use]
    pub fn any() -> Self {
        Self(None)
    }

    /// Is the host, with or without a port, one of these?
    pub(super) fn know(&self, host: &str) -> bool {
        let Some((bound, names)) = &self.0 else { return true };
        let name = name_of(host).to_ascii_lowercase();
        if names.contains(&name) || name == "localhost" {
            return true;
        }
        // A page that got here by an address is this port's own: no name was involved.
        name.parse().is_ok_and(|address: IpAddr| {
            let (address, bound) = (address.to_canonical(), bound.to_canonical());
            address == bound || bound.is_unspecified() || (bound.is_loopback() && address.is_loopback())
        })
    }
}

/// A host without its port, and an address without its brackets.
fn name_of(host: &str) -> &str {
    let end = host.rfind(']').map_or(0, |end| end + 1);
    let port = host[end..].rfind(':').filter(|_| end > 0 || host.matches(':').count() == 1);
    bare(&host[..port.map_or(host.len(), |at| end + at)])
}

fn bare(name: &str) -> &str {
    name.trim_start_matches('[').trim_end_matches(']').trim_end_matches('.')
}
