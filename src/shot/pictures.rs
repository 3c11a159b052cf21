//! Names in the shot file → files on disk: `board_*.jpg`.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// The files a name or a pattern (`*`, `?`, `[…]` in its last part) stands for, in natural order:
/// `ball_9` before `ball_10`. `Err` is a sentence without the file's name.
pub fn expand(pattern: &Path) -> Result<Vec<PathBuf>, String> {
    let name = pattern.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    // A name that is there as it is written is no pattern, whatever letters it has.
    if pattern.exists() || !name.contains(['*', '?', '[']) {
        return readable(pattern).map(|()| vec![pattern.to_owned()]);
    }
    let folder = pattern.parent().unwrap_or(Path::new(""));
    // The folder is a name, not a pattern: "shots [old]" must not match "shots o".
    let folder_name = folder.to_str().ok_or("its folder's name is not UTF-8; rename it")?;
    let whole = Path::new(&glob::Pattern::escape(folder_name)).join(name);
    let matches =
        glob::glob(&whole.to_string_lossy()).map_err(|e| format!("is no pattern: {e}"))?;
    let mut files: Vec<PathBuf> =
        matches.filter_map(Result::ok).filter(|path| path.is_file()).collect();
    if files.is_empty() {
        return Err("matches no file; check the pattern and the folder".to_owned());
    }
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    for file in &files {
        readable(file).map_err(|cause| format!("{}: {cause}", file.display()))?;
    }
    Ok(files)
}

/// Whether a file can be opened and has content. `Err` is a sentence without the file's name.
pub fn readable(path: &Path) -> Result<(), String> {
    let metadata = std::fs::metadata(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => "does not exist; copy it there or mend the name".to_owned(),
        _ => format!("{error}; check its permissions"),
    })?;
    if metadata.is_dir() {
        return Err("is a folder; name a file".to_owned());
    }
    if metadata.len() == 0 {
        return Err("is empty; copy it again".to_owned());
    }
    std::fs::File::open(path).map(drop).map_err(|e| format!("{e}; check its permissions"))
}

/// Text order in which runs of digits count as numbers.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a, b);
    loop {
        let (digits_a, digits_b) = (digits(a), digits(b));
        if digits_a > 0 && digits_b > 0 {
            let (number_a, number_b) = (&a[..digits_a], &b[..digits_b]);
            let (trim_a, trim_b) =
                (number_a.trim_start_matches('0'), number_b.trim_start_matches('0'));
            let order = (trim_a.len(), trim_a, digits_a).cmp(&(trim_b.len(), trim_b, digits_b));
            if order != Ordering::Equal {
                return order;
            }
            (a, b) = (&a[digits_a..], &b[digits_b..]);
            continue;
        }
        match (a.chars().next(), b.chars().next()) {
            (Some(x), Some(y)) if x == y => (a, b) = (&a[x.len_utf8()..], &b[y.len_utf8()..]),
            (x, y) => return x.cmp(&y),
        }
    }
}

fn digits(text: &str) -> usize {
    text.bytes().take_while(u8::is_ascii_digit).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_sort_as_numbers() {
        let mut names = ["b10.jpg", "b9.jpg", "b09.jpg", "a.jpg", "b1-2.jpg"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a.jpg", "b1-2.jpg", "b9.jpg", "b09.jpg", "b10.jpg"]);
    }

    #[test]
    fn patterns_match_in_their_last_part_only() {
        let folder = tempfile::tempdir().unwrap();
        let odd = folder.path().join("take [1]");
        std::fs::create_dir(&odd).unwrap();
        for name in ["b2.jpg", "b10.jpg", "c.jpg"] {
            std::fs::write(odd.join(name), "x").unwrap();
        }
        let files = expand(&odd.join("b*.jpg")).unwrap();
        let names: Vec<_> = files.iter().map(|f| f.file_name().unwrap()).collect();
        assert_eq!(names, ["b2.jpg", "b10.jpg"]);
        assert!(expand(&odd.join("d*.jpg")).unwrap_err().contains("matches no file"));
        assert!(expand(&odd.join("d.jpg")).unwrap_err().contains("does not exist"));
        assert!(expand(&odd).unwrap_err().contains("is a folder"));
        std::fs::write(odd.join("e.jpg"), "").unwrap();
        assert!(expand(&odd.join("e.jpg")).unwrap_err().contains("is empty"));
    }
}
