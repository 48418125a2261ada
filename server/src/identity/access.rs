//! The one table of everything the service answers, and the least role of each. What is not in it is denied.

use super::role::Role;

/// Who may call something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Everybody: it tells nothing that is not in the repository, or no more than whether the service is well.
    Open,
    /// Viewers, or everybody where `identity.open_metrics` says so.
    Metrics,
    /// Whoever has any role.
    AnyRole,
    /// Whoever has a role that includes this one.
    Least(Role),
}

use Access::{AnyRole, Least, Metrics, Open};
use Role::{Mapper, Operator, Vehicle, Viewer};

/// Something that can be called.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Call<'a> {
    /// A gRPC method by its path.
    Rpc(&'a str),
    /// A method of HTTP and a route, its parameters in braces. `HEAD` counts as `GET`.
    Http(&'a str, &'a str),
}

use Call::{Http, Rpc};

/// Every RPC and route.
pub const TABLE: &[(Call<'static>, Access)] = &[
    // The vehicles' port.
    (Rpc("/echofix.v1.LocalizationService/Localize"), Least(Vehicle)),
    (Rpc("/echofix.v1.LocalizationService/LocalizeStream"), Least(Vehicle)),
    (Rpc("/echofix.v1.MapService/GetTiles"), Least(Vehicle)),
    (Rpc("/echofix.v1.MapService/GetCoverage"), Least(Vehicle)),
    (Rpc("/echofix.v1.MappingService/Upload"), Least(Mapper)),
    // Load balancers have no identity.
    (Rpc("/grpc.health.v1.Health/Check"), Open),
    (Rpc("/grpc.health.v1.Health/Watch"), Open),
    // The contract is public; answering still costs something.
    (Rpc("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo"), AnyRole),
    // The operators' port. Probes and the console's files, which hold nothing of the map.
    (Http("GET", "/healthz"), Open),
    (Http("GET", "/readyz"), Open),
    (Http("GET", "/metrics"), Metrics),
    (Http("GET", "/openapi.json"), Open),
    (Http("GET", "/"), Open),
    (Http("GET", "/assets/{name}"), Open),
    // Of another's map, which its licence may not give to everybody.
    (Http("GET", "/base-map"), Least(Viewer)),
    (Http("GET", "/base-map.pmtiles"), Least(Viewer)),
    // Signing in and out; who has signed in.
    (Http("GET", "/session"), AnyRole),
    (Http("POST", "/session"), Open),
    (Http("DELETE", "/session"), Open),
    (Http("GET", "/session/ways"), Open),
    (Http("GET", "/session/oidc"), Open),
    (Http("GET", "/session/callback"), Open),
    // The map as it is served.
    (Http("GET", "/tiles/{layer}"), Least(Viewer)),
    (Http("GET", "/tiles/{layer}/{z}/{x}/{y}"), Least(Viewer)),
    (Http("GET", "/api/v1/map"), Least(Viewer)),
    (Http("GET", "/api/v1/map/history"), Least(Viewer)),
    (Http("GET", "/api/v1/map/quarantine"), Least(Viewer)),
    (Http("GET", "/api/v1/tiles/at"), Least(Viewer)),
    (Http("GET", "/api/v1/tiles/{epsg}/{x}/{y}"), Least(Viewer)),
    (Http("GET", "/api/v1/tiles/{epsg}/{x}/{y}/localizability"), Least(Viewer)),
    // Viewers are told of the cells that are served, operators of all, and who contributed.
    (Http("GET", "/api/v1/tiles/{epsg}/{x}/{y}/cells"), Least(Viewer)),
    (Http("GET", "/api/v1/cells/at"), Least(Viewer)),
    (Http("GET", "/api/v1/map/export"), Least(Viewer)),
    // Viewers get these events without the fixes, which tell where somebody is.
    (Http("GET", "/api/v1/events"), Least(Viewer)),
    (Http("GET", "/api/v1/uploads"), Least(Viewer)),
    (Http("GET", "/api/v1/fixes"), Least(Operator)),
    // Who contributes, if only by keyed hashes, is for those who may have to revoke one.
    (Http("GET", "/api/v1/contributors"), Least(Operator)),
    (Http("GET", "/api/v1/contributors/{hash}/uploads"), Least(Operator)),
    (Http("GET", "/api/v1/uploads/{id}"), Least(Operator)),
    // These fold or read everything, which takes a core for long.
    (Http("GET", "/api/v1/map/diff"), Least(Operator)),
    (Http("GET", "/api/v1/map/verify"), Least(Operator)),
    (Http("POST", "/api/v1/map/verify"), Least(Operator)),
    // A backup holds the key that contributors are hashed with.
    (Http("GET", "/api/v1/map/backup"), Least(Operator)),
    // Decisions.
    (Http("POST", "/api/v1/map/rollback"), Least(Operator)),
    (Http("POST", "/api/v1/map/revoke"), Least(Operator)),
    (Http("POST", "/api/v1/map/undo"), Least(Operator)),
    (Http("POST", "/api/v1/map/compact"), Least(Operator)),
    (Http("POST", "/api/v1/map/settle"), Least(Operator)),
    (Http("POST", "/api/v1/map/import"), Least(Operator)),
];

/// Who may make a call; `None` when it is not in the table, and so nobody.
#[must_use]
pub fn of(call: Call<'_>) -> Option<Access> {
    let call = match call {
        Http("HEAD", route) => Http("GET", route),
        other => other,
    };
    TABLE.iter().find(|(known, _)| *known == call).map(|(_, access)| *access)
}

/// The methods that a route answers, `HEAD` left out.
pub fn methods(route: &str) -> impl Iterator<Item = &'static str> {
    TABLE.iter().filter_map(move |(call, _)| match call {
        Http(method, known) if *known == route => Some(*method),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn nothing_is_in_the_table_twice() {
        let calls: HashSet<_> = TABLE.iter().map(|(call, _)| format!("{call:?}")).collect();
        assert_eq!(calls.len(), TABLE.len());
    }

    /// Catches: a call that is open because nobody thought of it.
    #[test]
    fn what_is_not_in_the_table_is_denied() {
        assert_eq!(of(Rpc("/echofix.v1.MappingService/Erase")), None);
        assert_eq!(of(Http("DELETE", "/api/v1/map")), None);
        assert_eq!(of(Http("GET", "/api/v1/map/rollback")), None);
        assert_eq!(of(Http("HEAD", "/api/v1/map")), Some(Least(Viewer)));
    }

    /// Catches: anything that changes the map, or tells where somebody is, for less than an operator.
    #[test]
    fn only_these_are_open() {
        let open = |access: &Access| matches!(access, Open | Metrics | AnyRole);
        let open: Vec<_> = TABLE.iter().filter(|(_, access)| open(access)).map(|(call, _)| *call).collect();
        for call in &open {
            let text = format!("{call:?}");
            assert!(
                !text.contains("/api/") && !text.contains("/tiles/") && !text.contains("echofix.v1"),
                "{text}"
            );
        }
        for (call, access) in TABLE {
            if let Http("POST" | "DELETE", route) = call {
                assert!(*route == "/session" || *access == Least(Operator), "{route}");
            }
        }
    }
}
