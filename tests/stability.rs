//! Every situation in `docs/stability.md` has its tests, under the names that stand there.

use std::path::Path;

fn read(path: &str) -> String {
    let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(whole).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// Whether a file holds a test of a name.
fn holds_test(file: &str, name: &str) -> bool {
    let head = format!("fn {name}() {{");
    file.match_indices(&head).any(|(at, _)| {
        let attributes = file[..at].rsplit("\n\n").next().unwrap_or("");
        attributes.contains("#[test]")
    })
}

#[test]
fn every_situation_has_its_tests() {
    let table = read("docs/stability.md");
    let mut situations = Vec::new();
    for row in table.lines().filter(|line| line.starts_with("| G") || line.starts_with("| B")) {
        let mut cells = row.split('|').map(str::trim).skip(1);
        let (numbers, tests) = (cells.next().unwrap_or(""), cells.nth(1).unwrap_or(""));
        situations.extend(numbers.split(", ").map(String::from));
        let mut named = tests.split('`').skip(1).step_by(2);
        let mut n_tests = 0;
        while let (Some(file), Some(name)) = (named.next(), named.next()) {
            assert!(holds_test(&read(file), name), "{numbers}: {file} has no test {name}");
            n_tests += 1;
        }
        assert!(n_tests > 0, "{numbers} names no test");
    }
    for number in 1..=32 {
        let wanted = format!("G{number}");
        assert!(situations.contains(&wanted), "{wanted} is not in the table");
    }
}
