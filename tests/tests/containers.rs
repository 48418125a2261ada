//! What `docker/` sets is what the command takes.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::process::Command;

use echofix_tests::binary;

/// The variables of a container in the manifests: those of `env` that are written on one line, and those of the bucket's map.
fn of_manifests(replicas: &str, kustomization: &str) -> Vec<(String, String)> {
    let one_line = |line: &str| {
        let inner = line.trim().strip_prefix("- {name: ECHOFIX_")?.strip_suffix('}')?;
        let (name, value) = inner.split_once(", value: ")?;
        Some((format!("ECHOFIX_{name}"), value.trim_matches(['"', '\'']).to_owned()))
    };
    let url = kustomization.lines().find_map(|line| line.trim().strip_prefix("- url="));
    let url = ("ECHOFIX_STORE_URL".to_owned(), url.expect("the bucket is named").to_owned());
    replicas.lines().filter_map(one_line).chain([url]).collect()
}

/// The servers that a balancer's configuration names.
fn servers(balancer: &str) -> Vec<&str> {
    balancer
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            (words.next() == Some("server")).then(|| words.next().unwrap())
        })
        .collect()
}

/// The variables of the replicas in the compose file, as its lines have them.
fn variables(compose: &str) -> Vec<(String, String)> {
    let pairs = compose.lines().filter_map(|line| line.trim().split_once(": "));
    let ours = pairs.filter(|(name, _)| name.starts_with("ECHOFIX_") || name.starts_with("AWS_"));
    ours.map(|(name, value)| (name.to_owned(), value.trim_matches('"').to_owned())).collect()
}

fn checked(variables: &[(String, String)]) -> bool {
    let mut command = Command::new(binary::echofix());
    // As the image sets it.
    command.env("ECHOFIX_GRPC_LISTEN", "0.0.0.0:50051").env("ECHOFIX_HTTP_LISTEN", "0.0.0.0:8080");
    command.envs(variables.iter().map(|(name, value)| (name, value)));
    command.args(["serve", "--check-config"]).output().unwrap().status.success()
}

/// Catches: a setting of the replicas' compose file that the command does not know or take, and servers that the balancer
/// names and the compose file does not start.
#[test]
fn the_replicas_compose_file_says_what_the_command_takes() {
    let compose = include_str!("../../docker/replicas/compose.yaml");
    let mut variables = variables(compose);
    assert!(variables.len() >= 8, "{variables:?}");
    assert!(checked(&variables));
    let servers = servers(include_str!("../../docker/haproxy.cfg"));
    assert_eq!(servers, ["replica-0", "replica-1", "replica-2"]);
    for server in servers {
        assert!(compose.contains(&format!("\n  {server}:\n")), "{server}");
    }
    variables.push(("ECHOFIX_STORE_NO_SUCH_KEY".to_owned(), "1".to_owned()));
    assert!(!checked(&variables), "the check finds what is wrong");
}

/// Catches: a setting of the replicas' manifests that the command does not know or take, files that no volume brings, as many
/// servers in the balancer as there are replicas, by the names that the cluster gives them, and two balancers that differ in how
/// they send regions.
#[test]
fn the_replicas_manifests_say_what_the_command_takes() {
    let replicas = include_str!("../../docker/replicas/kubernetes/replicas.yaml");
    let kustomization = include_str!("../../docker/replicas/kubernetes/kustomization.yaml");
    let balancer = include_str!("../../docker/replicas/kubernetes/haproxy.cfg");
    let variables = of_manifests(replicas, kustomization);
    assert!(variables.len() >= 8, "{variables:?}");

    // The files as whoever follows the first lines makes them.
    let folder = tempfile::tempdir().unwrap();
    let identity = folder.path().join("identity");
    let made = Command::new(binary::echofix()).args(["identity", "init"]).arg(&identity).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let tokens = folder.path().join("tokens");
    let token = ["token", "create", "--name", "vehicles", "--role", "vehicle,mapper", "--file"];
    let made = Command::new(binary::echofix()).args(token).arg(&tokens).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let here = |value: &str| {
        let value = value.replace("/identity/", &format!("{}/", identity.display()));
        value.replace("/tokens/tokens", &tokens.display().to_string())
    };
    let mut found: Vec<_> = variables.into_iter().map(|(name, value)| (name, here(&value))).collect();
    assert!(checked(&found), "{found:?}");
    found.push(("ECHOFIX_STORE_NO_SUCH_KEY".to_owned(), "1".to_owned()));
    assert!(!checked(&found), "the check finds what is wrong");

    for mounted in ["/identity", "/tokens", "/authorities", "/data"] {
        assert!(replicas.contains(&format!("mountPath: {mounted}")), "{mounted}");
    }
    let count = replicas.lines().find_map(|line| line.trim().strip_prefix("replicas: "));
    let names: Vec<_> =
        (0..count.unwrap().parse().unwrap()).map(|at: usize| format!("replica-{at}")).collect();
    assert_eq!(servers(balancer), names);
    for name in &names {
        assert!(
            balancer.contains(&format!(" {name}.replicas.echofix-replicas.svc.cluster.local:50051 ")),
            "{name}"
        );
        assert!(kustomization.contains(&format!("--name {name}.replicas")), "{name} is in the certificate");
    }
    let sends = |text: &str| -> Vec<String> {
        let of_hash = |line: &&str| line.starts_with("balance ") || line.starts_with("hash-");
        text.lines().map(str::trim).filter(of_hash).map(str::to_owned).collect()
    };
    assert_eq!(sends(balancer), sends(include_str!("../../docker/haproxy.cfg")));
    for file in ["namespace.yaml", "replicas.yaml", "balancer.yaml", "network.yaml"] {
        assert!(kustomization.contains(&format!("  - {file}\n")), "{file}");
    }
}
