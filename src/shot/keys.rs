//! A TOML table read key by key, noting every problem instead of stopping at the first.
//!
//! [`Problems`] collects sentences that name file, line and key. [`Keys`] is one table: it is
//! opened with the list of keys it may hold, and a key outside the list is a problem that names the
//! nearest one. Reading a value that is missing or wrong gives `None` and, if it is wrong, a problem.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::{frames, pictures};
use crate::conventions::FARTHEST_M;
use crate::light::moment::{Moment, MomentError};

/// Everything found wrong with one file, each with file, line, key and remedy.
#[derive(Debug)]
pub struct Problems<'a> {
    file: PathBuf,
    text: &'a str,
    found: RefCell<Vec<String>>,
    files: RefCell<Vec<NamedFile>>,
}

/// A file or pattern that the text names.
#[derive(Clone, Debug)]
struct NamedFile {
    byte: usize,
    key: String,
    path: PathBuf,
}

impl<'a> Problems<'a> {
    pub fn new(file: &Path, text: &'a str) -> Self {
        Self { file: file.to_owned(), text, found: RefCell::default(), files: RefCell::default() }
    }

    /// Notes every named file that is not there or cannot be read.
    pub fn look_at_files(&self) {
        for NamedFile { byte, key, path } in self.files.take() {
            if let Err(cause) = pictures::expand(&path) {
                self.note(byte, &format!("{key}: {}: {cause}", path.display()));
            }
        }
    }

    /// Notes a problem at a byte of the file.
    pub fn note(&self, byte: usize, sentence: &str) {
        let line = 1 + self.text.bytes().take(byte).filter(|&b| b == b'\n').count();
        self.found.borrow_mut().push(format!("{}:{line}: {sentence}", self.file.display()));
    }

    pub fn is_empty(&self) -> bool {
        self.found.borrow().is_empty()
    }

    /// All problems so far, in the order in which they were found.
    pub fn into_sentences(self) -> Vec<String> {
        self.found.into_inner()
    }
}

/// One table of a TOML file.
#[derive(Debug)]
pub struct Keys<'a> {
    problems: &'a Problems<'a>,
    /// Dotted name, empty for the file itself.
    name: String,
    start: usize,
    table: &'a DeTable<'a>,
    known: &'static [&'static str],
    /// Keys that unknown ones are misspelt from.
    misspelt: Vec<&'static str>,
}

/// The known word that was probably meant, if any is near.
pub fn nearest<'k>(word: &str, known: &[&'k str]) -> Option<&'k str> {
    known
        .iter()
        .map(|known| (strsim::osa_distance(word, known), *known))
        .min_by_key(|&(distance, _)| distance)
        // More than half the letters wrong is no misprint.
        .filter(|&(distance, known)| 2 * distance <= known.len().max(word.len()))
        .map(|(_, known)| known)
}

impl<'a> Keys<'a> {
    /// The whole file.
    pub fn root(
        problems: &'a Problems<'a>,
        table: &'a DeTable<'a>,
        known: &'static [&'static str],
    ) -> Self {
        Self::open(problems, String::new(), 0, table, known)
    }

    fn open(
        problems: &'a Problems<'a>,
        name: String,
        start: usize,
        table: &'a DeTable<'a>,
        known: &'static [&'static str],
    ) -> Self {
        let mut keys = Self { problems, name, start, table, known, misspelt: Vec::new() };
        for key in table.keys() {
            if !known.contains(&key.get_ref().as_ref()) {
                let meant = keys.unknown(key.get_ref(), key.span().start);
                keys.misspelt.extend(meant);
            }
        }
        keys
    }

    /// Notes a key that is not known; returns the one it is misspelt from, if it is near one.
    fn unknown(&self, key: &str, byte: usize) -> Option<&'static str> {
        let nearest = nearest(key, self.known);
        let remedy = match nearest {
            Some(known) => format!("did you mean `{}`?", self.path(known)),
            None => format!("known here: {}", self.known.join(", ")),
        };
        self.problems.note(byte, &format!("{}: unknown key; {remedy}", self.path(key)));
        nearest
    }

    /// Dotted name of a key of this table.
    pub fn path(&self, key: &str) -> String {
        if self.name.is_empty() { key.to_owned() } else { format!("{}.{key}", self.name) }
    }

    pub fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    fn value(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        debug_assert!(self.known.contains(&key), "{} is asked for but not known", self.path(key));
        self.table.get(key)
    }

    /// Notes a problem with the value of `key`, or with the table if the key is not there.
    pub fn problem(&self, key: &str, sentence: &str) {
        let byte = self.table.get(key).map_or(self.start, |value| value.span().start);
        self.problems.note(byte, &format!("{}: {sentence}", self.path(key)));
    }

    /// The value, or a problem if the key is missing. One that is misspelt was told of already.
    pub fn need<T>(&self, key: &'static str, value: Option<T>, remedy: &str) -> Option<T> {
        if !self.has(key) && !self.misspelt.contains(&key) {
            self.problem(key, &format!("is missing; {remedy}"));
        }
        value
    }

    fn read<T>(
        &self,
        key: &'static str,
        expected: &str,
        convert: impl FnOnce(&'a DeValue<'a>) -> Option<T>,
    ) -> Option<T> {
        let value = self.value(key)?.get_ref();
        let converted = convert(value);
        if converted.is_none() {
            self.problem(key, &format!("expected {expected}, found {}", kind(value)));
        }
        converted
    }

    pub fn text(&self, key: &'static str) -> Option<&'a str> {
        self.read(key, "a text in quotes", |v| v.as_str())
    }

    /// The path of a file or pattern, relative to `folder` in the text; noted among the named files.
    pub fn file(&self, key: &'static str, folder: &Path) -> Option<PathBuf> {
        let path = folder.join(self.text(key)?);
        self.names_file(key, path.clone());
        Some(path)
    }

    /// Notes that the value of `key` stands for this file.
    pub fn names_file(&self, key: &str, path: PathBuf) {
        let byte = self.table.get(key).map_or(self.start, |value| value.span().start);
        self.problems.files.borrow_mut().push(NamedFile { byte, key: self.path(key), path });
    }

    pub fn flag(&self, key: &'static str) -> Option<bool> {
        self.read(key, "true or false", |v| v.as_bool())
    }

    /// A finite number.
    pub fn number(&self, key: &'static str) -> Option<f64> {
        self.read(key, "a finite number", number)
    }

    /// A number above zero.
    pub fn positive(&self, key: &'static str) -> Option<f64> {
        self.read(key, "a number above 0", |v| number(v).filter(|&x| x > 0.0))
    }

    /// A whole number from 0 on.
    pub fn count(&self, key: &'static str) -> Option<u32> {
        self.read(key, "a whole number from 0 to 4294967295", count)
    }

    /// A whole number as frames have them, also below zero.
    pub fn whole(&self, key: &'static str) -> Option<i64> {
        self.read(key, "a whole number as frames have them", whole)
    }

    /// A moment with its zone: a date and time as TOML has it, or the same as a text.
    pub fn moment(&self, key: &'static str) -> Option<Moment> {
        let text = self.read(key, "a date and time, 2026-06-21T12:00:00+02:00", |v| match v {
            DeValue::Datetime(moment) => Some(moment.to_string()),
            other => other.as_str().map(str::to_owned),
        })?;
        text.parse().map_err(|error: MomentError| self.problem(key, &error.to_string())).ok()
    }

    /// `N` finite numbers.
    pub fn numbers<const N: usize>(&self, key: &'static str) -> Option<[f64; N]> {
        self.read(key, &format!("{N} finite numbers in brackets"), |v| numbers(v.as_array()?))
    }

    /// `N` finite numbers above zero.
    pub fn positives<const N: usize>(&self, key: &'static str) -> Option<[f64; N]> {
        self.read(key, &format!("{N} numbers above 0 in brackets"), |v| {
            numbers(v.as_array()?).filter(|all: &[f64; N]| all.iter().all(|&x| x > 0.0))
        })
    }

    /// `N` whole numbers.
    pub fn counts<const N: usize>(&self, key: &'static str) -> Option<[u32; N]> {
        self.read(key, &format!("{N} whole numbers in brackets"), |v| {
            fixed(v.as_array()?.iter().map(|v| count(v.get_ref())))
        })
    }

    /// `N` points of `M` finite numbers.
    pub fn points<const N: usize, const M: usize>(
        &self,
        key: &'static str,
    ) -> Option<[[f64; M]; N]> {
        self.read(key, &format!("{N} points of {M} numbers, [[u, v], …]"), |v| {
            fixed(v.as_array()?.iter().map(|v| numbers(v.get_ref().as_array()?)))
        })
    }

    /// A place in the world, metres: no farther out than [`FARTHEST_M`] along any axis.
    pub fn place(&self, key: &'static str) -> Option<[f64; 3]> {
        let expected = format!("a place, 3 numbers in metres of at most {FARTHEST_M:e}");
        self.read(key, &expected, |v| {
            numbers(v.as_array()?).filter(|at: &[f64; 3]| at.iter().all(|x| x.abs() <= FARTHEST_M))
        })
    }

    /// A length-free direction: three finite numbers that are not all zero.
    pub fn direction(&self, key: &'static str) -> Option<[f64; 3]> {
        self.read(key, "a direction, three numbers that are not all 0", |v| {
            numbers(v.as_array()?).filter(|d: &[f64; 3]| d.iter().any(|&x| x != 0.0))
        })
    }

    /// One of some named choices.
    pub fn choice<T: Copy>(&self, key: &'static str, choices: &[(&str, T)]) -> Option<T> {
        let found = self.text(key)?;
        let choice = choices.iter().find(|(name, _)| *name == found).map(|&(_, value)| value);
        if choice.is_none() {
            let names: Vec<String> =
                choices.iter().map(|(name, _)| format!("\"{name}\"")).collect();
            self.problem(key, &format!("\"{found}\" is not known; write {}", names.join(" or ")));
        }
        choice
    }

    /// A list of texts, or a single one.
    pub fn texts(&self, key: &'static str) -> Option<Vec<&'a str>> {
        self.read(key, "a text or a list of texts", |v| match v {
            DeValue::String(text) => Some(vec![text.as_ref()]),
            DeValue::Array(array) => array.iter().map(|v| v.get_ref().as_str()).collect(),
            _ => None,
        })
    }

    /// True if the value is a text.
    pub fn is_text(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(|v| v.get_ref().as_str().is_some())
    }

    /// True if the value is a list.
    pub fn is_list(&self, key: &str) -> bool {
        self.table.get(key).is_some_and(|v| v.get_ref().as_array().is_some())
    }

    /// A table with these keys and no others.
    pub fn table(&self, key: &'static str, known: &'static [&'static str]) -> Option<Self> {
        let value = self.value(key)?;
        let Some(table) = value.get_ref().as_table() else {
            let found = kind(value.get_ref());
            let form = self.form(key, known);
            self.problem(key, &format!("expected a table, found {found}; {form}"));
            return None;
        };
        Some(Self::open(self.problems, self.path(key), value.span().start, table, known))
    }

    /// How the table `key` of these keys is written.
    fn form(&self, key: &str, known: &[&str]) -> String {
        if self.name.is_empty() {
            return format!("write [{key}], in single brackets, once");
        }
        let some = known.iter().take(3).map(|known| format!("{known} = …"));
        let rest = (known.len() > 3).then(|| "…".to_owned());
        let inside = some.chain(rest).collect::<Vec<_>>().join(", ");
        format!("write {key} = {{ {inside} }}, in braces, once")
    }

    /// A list of tables, each with these keys and no others; empty if the key is missing.
    pub fn tables(&self, key: &'static str, known: &'static [&'static str]) -> Vec<Self> {
        let Some(value) = self.value(key) else { return Vec::new() };
        let form = format!("write [[{}]], in double brackets, for each", self.path(key));
        let Some(array) = value.get_ref().as_array() else {
            let found = kind(value.get_ref());
            self.problem(key, &format!("expected a list of tables, found {found}; {form}"));
            return Vec::new();
        };
        let mut tables = Vec::with_capacity(array.len());
        for (i, value) in array.iter().enumerate() {
            let name = format!("{}[{i}]", self.path(key));
            let start = value.span().start;
            match value.get_ref().as_table() {
                Some(table) => tables.push(Self::open(self.problems, name, start, table, known)),
                None => self.problems.note(
                    start,
                    &format!("{name}: expected a table, found {}; {form}", kind(value.get_ref())),
                ),
            }
        }
        tables
    }

    /// Which one of `keys` is there; none or several are a problem, a misspelt one was told of already.
    pub fn exactly_one(&self, keys: &'static [&'static str]) -> Option<&'static str> {
        let there: Vec<&str> = keys.iter().copied().filter(|key| self.has(key)).collect();
        match there.as_slice() {
            [one] => Some(one),
            [] if keys.iter().any(|key| self.misspelt.contains(key)) => None,
            [] => {
                let sentence = format!("one of {} is needed", keys.join(", "));
                self.problems.note(self.start, &format!("[{}]: {sentence}", self.name));
                None
            }
            [first, ..] => {
                let sentence = format!("{} exclude each other; keep one", there.join(" and "));
                self.problem(first, &sentence);
                None
            }
        }
    }
}

fn number(value: &DeValue) -> Option<f64> {
    let number = match value {
        DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok()? as f64,
        DeValue::Float(f) => f.as_str().parse().ok()?,
        _ => return None,
    };
    number.is_finite().then_some(number)
}

fn count(value: &DeValue) -> Option<u32> {
    match value {
        DeValue::Integer(i) => u32::from_str_radix(i.as_str(), i.radix()).ok(),
        _ => None,
    }
}

fn whole(value: &DeValue) -> Option<i64> {
    match value {
        DeValue::Integer(i) => {
            i64::from_str_radix(i.as_str(), i.radix()).ok().filter(frames::is_number)
        }
        _ => None,
    }
}

fn numbers<const N: usize>(array: &DeArray) -> Option<[f64; N]> {
    fixed(array.iter().map(|v| number(v.get_ref())))
}

fn fixed<T, const N: usize>(values: impl Iterator<Item = Option<T>>) -> Option<[T; N]> {
    values.collect::<Option<Vec<T>>>()?.try_into().ok()
}

/// Longest value that a sentence shows, characters.
const SHOWN: usize = 60;

/// What a value is, for a sentence.
fn kind(value: &DeValue) -> String {
    match value {
        // `Debug` keeps a text of many lines on one.
        DeValue::String(text) => format!("the text {}", shortened(&format!("{text:?}"))),
        DeValue::Integer(i) => format!("{i}"),
        DeValue::Float(f) => format!("{f}"),
        DeValue::Boolean(b) => format!("{b}"),
        DeValue::Datetime(_) => "a date".to_owned(),
        DeValue::Array(array) => {
            let values: Vec<String> = array.iter().take(SHOWN).map(|v| item(v.get_ref())).collect();
            format!("{} values, {}", array.len(), shortened(&format!("[{}]", values.join(", "))))
        }
        DeValue::Table(_) => "a table".to_owned(),
    }
}

/// What a value of a list is: as it is written, without words around it.
fn item(value: &DeValue) -> String {
    match value {
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Array(_) => "[…]".to_owned(),
        DeValue::Table(_) => "{…}".to_owned(),
        other => kind(other),
    }
}

fn shortened(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}…", &text[..end]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(text: &str, read: impl FnOnce(&Keys)) -> Vec<String> {
        let parsed = DeTable::parse(text).expect("the test's text is TOML");
        let problems = Problems::new(Path::new("s.toml"), text);
        read(&Keys::root(&problems, parsed.get_ref(), &["plate", "error", "one", "other"]));
        problems.into_sentences()
    }

    #[test]
    fn unknown_key_names_line_and_nearest_key() {
        let found = problems("\n\nplaet = 1\nquite_different = 2\n", |_| {});
        assert_eq!(
            found,
            [
                "s.toml:3: plaet: unknown key; did you mean `plate`?",
                "s.toml:4: quite_different: unknown key; known here: plate, error, one, other",
            ]
        );
    }

    #[test]
    fn wrong_kinds_say_what_was_expected_and_found() {
        let found = problems("error = \"x\"\nplate = [1, 2]\none = nan\n", |keys| {
            assert_eq!(keys.number("error"), None);
            assert_eq!(keys.numbers::<3>("plate"), None);
            assert_eq!(keys.number("one"), None);
            assert_eq!(keys.number("other"), None);
        });
        assert_eq!(
            found,
            [
                "s.toml:1: error: expected a finite number, found the text \"x\"",
                "s.toml:2: plate: expected 3 finite numbers in brackets, found 2 values, [1, 2]",
                "s.toml:3: one: expected a finite number, found nan",
            ]
        );
    }

    #[test]
    fn values_are_shown_on_one_line_and_not_whole_books() {
        let long = "é".repeat(5000);
        let text =
            format!("error = \"\"\"\na\nb\"\"\"\nplate = [1, \"x\", [], {{}}]\none = \"{long}\"\n");
        let found = problems(&text, |keys| {
            keys.number("error");
            keys.numbers::<4>("plate");
            keys.number("one");
        });
        assert!(found[0].ends_with("found the text \"a\\nb\""), "{}", found[0]);
        assert!(found[1].ends_with("found 4 values, [1, \"x\", […], {…}]"), "{}", found[1]);
        assert!(found[2].ends_with('…') && found[2].chars().count() < 150, "{}", found[2]);
    }

    #[test]
    fn integers_of_any_radix_are_numbers() {
        let found = problems("error = 0x10\nplate = [1, 2.5, -3]\n", |keys| {
            assert_eq!(keys.number("error"), Some(16.0));
            assert_eq!(keys.numbers::<3>("plate"), Some([1.0, 2.5, -3.0]));
        });
        assert!(found.is_empty(), "{found:?}");
    }

    #[test]
    fn groups_need_exactly_one_key() {
        let none = problems("", |keys| assert_eq!(keys.exactly_one(&["one", "other"]), None));
        assert!(none[0].contains("one of one, other is needed"), "{none:?}");
        let both = problems("one = 1\nother = 2\n", |keys| {
            assert_eq!(keys.exactly_one(&["one", "other"]), None);
        });
        assert!(both[0].contains("exclude each other"), "{both:?}");
    }
}
