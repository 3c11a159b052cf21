//! No file does harm: the fuzz corpus replayed, and seeded random mutations of valid files.
//!
//! Promised for each format: an error or a sound result, no panic, no abort, and no single
//! allocation much larger than the limit that was set, whatever a header claims.

#[path = "../../fuzz/src/formats.rs"]
mod formats;
mod seeds;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs;
use std::panic::{self, AssertUnwindSafe};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use formats::FORMATS;

/// The system's allocator, which remembers the largest request.
struct Watching;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// Safety: every request goes to `System` unchanged.
unsafe impl GlobalAlloc for Watching {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Watching = Watching;

/// The limit is 16 MiB, linear light included; but the TIFF decoder takes up to 256 MiB for one tag
/// before it can be told less.
const LARGEST_ALLOWED: usize = 17 * formats::MAX_BYTES as usize;

thread_local! {
    /// True while a format reads: its caught panics are not news.
    static READING: Cell<bool> = const { Cell::new(false) };
}

fn quiet_while_reading() {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let on_worker = std::thread::current().name().is_none();
        if !on_worker && !READING.get() {
            usual(info);
        }
    }));
}

/// Reads the bytes; what went wrong, if a promise was broken.
fn broken(read: fn(&[u8]), bytes: &[u8]) -> Option<String> {
    LARGEST.store(0, Ordering::Relaxed);
    READING.set(true);
    let outcome = panic::catch_unwind(AssertUnwindSafe(|| read(bytes)));
    READING.set(false);
    let largest = LARGEST.load(Ordering::Relaxed);
    match outcome {
        Err(cause) => Some(
            cause
                .downcast_ref::<String>()
                .cloned()
                .or_else(|| cause.downcast_ref::<&str>().map(ToString::to_string))
                .unwrap_or_else(|| "panicked".into()),
        ),
        Ok(()) if largest > LARGEST_ALLOWED => Some(format!("asked for {largest} bytes at once")),
        Ok(()) => None,
    }
}

fn corpus(format: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "fuzz", "corpus", format].iter().collect()
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// A file like `seed` with one to four things wrong.
fn mutated(seed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        match random.below(8) {
            0 => bytes.truncate(at),
            1 | 2 if at < bytes.len() => bytes[at] = random.next() as u8,
            3 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            4 | 5 => {
                // Numbers at the edges, in either byte order.
                let edges = [0, 1, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, u32::MAX, 1 << 24];
                let edge = edges[random.below(edges.len())];
                let raw =
                    if random.below(2) == 0 { edge.to_le_bytes() } else { edge.to_be_bytes() };
                for (to, from) in bytes.iter_mut().skip(at).zip(raw) {
                    *to = from;
                }
            }
            6 => {
                let end = (at + random.below(64)).min(bytes.len());
                let copy = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, copy);
            }
            _ => {
                let end = (at + random.below(16)).min(bytes.len());
                bytes.drain(at..end);
            }
        }
    }
    bytes
}

#[test]
fn hostile_files_do_no_harm() {
    quiet_while_reading();
    let mutations = std::env::var("PLATELIGHT_MUTATIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(2000usize);
    let mut failures = Vec::new();
    for (format, read) in FORMATS {
        let mut seeds: Vec<(String, Vec<u8>)> = fs::read_dir(corpus(format))
            .unwrap_or_else(|e| panic!("fuzz/corpus/{format}: {e}"))
            .map(|entry| {
                let path = entry.expect("the corpus is readable").path();
                let name = path.file_name().expect("it is a file").to_string_lossy().into_owned();
                (name, fs::read(path).expect("the corpus is readable"))
            })
            .collect();
        seeds.sort();
        assert!(!seeds.is_empty(), "fuzz/corpus/{format} is empty");
        for (name, bytes) in &seeds {
            if let Some(cause) = broken(read, bytes) {
                failures.push(format!("{format}/{name}: {cause}"));
            }
        }
        let mut random = Random(0x706c_6174_656c);
        for i in 0..mutations {
            let bytes = mutated(&seeds[i % seeds.len()].1, &mut random);
            if let Some(cause) = broken(read, &bytes) {
                let kept = std::env::temp_dir().join(format!("platelight-{format}-{i}"));
                fs::write(&kept, &bytes).expect("the temporary folder can be written");
                failures.push(format!("{format} mutation {i} ({}): {cause}", kept.display()));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn the_corpus_has_every_seed() {
    // PLATELIGHT_BLESS=1 writes the seeds; otherwise each must be there as it is made.
    let bless = std::env::var_os("PLATELIGHT_BLESS").is_some();
    let mut total = 0;
    for (format, _) in FORMATS {
        for (name, bytes) in seeds::of(format) {
            let path = corpus(format).join(name);
            if bless {
                fs::create_dir_all(corpus(format)).expect("the corpus can be written");
                fs::write(&path, &bytes).expect("the corpus can be written");
            }
            let kept = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            assert_eq!(kept, bytes, "{} is not the seed as it is made", path.display());
        }
        for entry in fs::read_dir(corpus(format)).expect("the corpus is readable") {
            total += entry.expect("the corpus is readable").metadata().expect("a file").len();
        }
    }
    assert!(total < 200_000, "the corpus has grown to {total} bytes");
}
