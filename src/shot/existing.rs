//! Is a shot already done? Its report says from which inputs, and how large its files were.

use std::path::Path;

use super::write::FileMark;

/// The program as reports name it. Another version may make another picture.
pub const PROGRAM: &str = concat!("platelight ", env!("CARGO_PKG_VERSION"));

/// Whether the report at `report` tells of a complete run by this version of the program with these
/// settings, seed and inputs, and all files it names are still as it left them.
pub fn is_complete(
    report: &Path,
    settings: &serde_json::Value,
    seed: u64,
    inputs: &[FileMark],
) -> bool {
    read(report).is_some_and(|report| {
        let same = |key: &str, value: &serde_json::Value| report.get(key) == Some(value);
        let marks = |key: &str| report.get(key).and_then(|marks| marks.as_array());
        let (Ok(inputs), Some(outputs)) = (serde_json::to_value(inputs), marks("outputs")) else {
            return false;
        };
        let complete = report.pointer("/render/complete") == Some(&true.into());
        complete
            && same("program", &PROGRAM.into())
            && same("shot", settings)
            && same("seed", &seed.into())
            && same("inputs", &inputs)
            && !outputs.is_empty()
            && outputs.iter().all(is_as_it_was)
    })
}

fn read(path: &Path) -> Option<serde_json::Value> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

fn is_as_it_was(mark: &serde_json::Value) -> bool {
    let now =
        mark.get("file").and_then(|file| file.as_str()).and_then(|f| FileMark::of(f.as_ref()));
    now.and_then(|now| serde_json::to_value(now).ok()).as_ref() == Some(mark)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_the_same_inputs_and_untouched_outputs_count() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("in"), folder.path().join("out.exr"));
        std::fs::write(&input, "plate").unwrap();
        std::fs::write(&output, "picture").unwrap();
        let inputs = [FileMark::of(&input).unwrap()];
        let report = folder.path().join("report.json");
        let write = |complete: bool, program: &str| {
            let outputs = [FileMark::of(&output)];
            let text = json!({ "program": program, "shot": { "a": 1 }, "seed": 3, "inputs": inputs, "outputs": outputs,
                "render": { "complete": complete } });
            std::fs::write(&report, text.to_string()).unwrap();
        };
        let settings = json!({ "a": 1 });
        assert!(!is_complete(&report, &settings, 3, &inputs), "there is no report");
        write(false, PROGRAM);
        assert!(!is_complete(&report, &settings, 3, &inputs), "was stopped early");
        write(true, "platelight 0.0.1");
        assert!(!is_complete(&report, &settings, 3, &inputs), "another version's");
        write(true, PROGRAM);
        assert!(is_complete(&report, &settings, 3, &inputs));
        assert!(!is_complete(&report, &json!({ "a": 2 }), 3, &inputs), "other settings");
        assert!(!is_complete(&report, &settings, 4, &inputs), "other seed");
        std::fs::write(&output, "pict").unwrap();
        assert!(!is_complete(&report, &settings, 3, &inputs), "the output was cut");
    }
}
