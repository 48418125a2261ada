//! What `docker/` sets is what the command takes.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::process::Command;

use echofix_tests::binary;

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
    let servers = include_str!("../../docker/haproxy.cfg").lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        (words.next() == Some("server")).then(|| words.next().unwrap())
    });
    let servers: Vec<_> = servers.collect();
    assert_eq!(servers, ["replica-0", "replica-1", "replica-2"]);
    for server in servers {
        assert!(compose.contains(&format!("\n  {server}:\n")), "{server}");
    }
    variables.push(("ECHOFIX_STORE_NO_SUCH_KEY".to_owned(), "1".to_owned()));
    assert!(!checked(&variables), "the check finds what is wrong");
}
