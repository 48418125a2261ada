//! `docs/walk.md` names tests that are there.

use std::fs;
use std::path::Path;

/// Catches: a claim of the walk whose test was renamed, moved or removed, and a claim without one.
#[test]
fn every_claim_of_the_walk_has_its_test() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let walk = fs::read_to_string(repository.join("docs/walk.md")).expect("the walk is there");
    let mut claims = 0;
    for line in walk.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| claim |")) {
        let named: Vec<_> = line.split('`').filter_map(|text| text.split_once(".rs::")).collect();
        assert!(!named.is_empty(), "no test is named: {line}");
        for (file, test) in named {
            let path = repository.join(format!("{file}.rs"));
            let source =
                fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            let (before, _) = source
                .split_once(&format!("fn {test}("))
                .unwrap_or_else(|| panic!("{} has no test `{test}`", path.display()));
            let attributes = before.rsplit("\n\n").next().unwrap_or_default();
            assert!(attributes.contains("#[test]") || attributes.contains("::test"), "`{test}` is no test");
        }
        claims += 1;
    }
    assert!(claims > 30, "{claims} claims");
}
