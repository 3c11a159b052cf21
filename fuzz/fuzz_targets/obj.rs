#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| platelight_fuzz::formats::obj(bytes));
