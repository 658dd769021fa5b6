//! What the module exports: a place for the input, one request, and where its answer lies. An
//! instance holds one session and lives as long as its worker. A panic ends the instance; what it
//! said can be read afterwards.
#![expect(
    unsafe_code,
    reason = "an exported name is one that no other library here may have"
)]

use std::{
    cell::RefCell,
    sync::{Mutex, Once},
};

use crate::Session;

thread_local! {
    static SESSION: RefCell<Session> = RefCell::default();
    static INPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static RESPONSE: RefCell<Buffers> = RefCell::default();
}

static PANIC: Mutex<String> = Mutex::new(String::new());

#[derive(Default)]
struct Buffers {
    json: Vec<u8>,
    bytes: Vec<u8>,
}

/// Makes place for an input of so many bytes and says where.
#[unsafe(no_mangle)]
pub extern "C" fn reel_input(length: usize) -> *mut u8 {
    INPUT.with_borrow_mut(|input| {
        input.clear();
        input.resize(length, 0);
        input.as_mut_ptr()
    })
}

/// Answers the request in the input: so many bytes of JSON, then bytes.
#[unsafe(no_mangle)]
pub extern "C" fn reel_request(json_length: usize) {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        std::panic::set_hook(Box::new(|about| {
            if let Ok(mut text) = PANIC.lock() {
                *text = about.to_string();
            }
        }));
    });
    let input = INPUT.take();
    let (json, bytes) = input.split_at(json_length.min(input.len()));
    let response = SESSION.with_borrow_mut(|session| session.respond_json(json, bytes));
    RESPONSE.set(Buffers {
        json: response.0,
        bytes: response.1,
    });
}

/// Where the JSON of the last response lies.
#[unsafe(no_mangle)]
pub extern "C" fn reel_json() -> *const u8 {
    RESPONSE.with_borrow(|response| response.json.as_ptr())
}

/// How many bytes the JSON of the last response has.
#[unsafe(no_mangle)]
pub extern "C" fn reel_json_length() -> usize {
    RESPONSE.with_borrow(|response| response.json.len())
}

/// Where the bytes of the last response lie.
#[unsafe(no_mangle)]
pub extern "C" fn reel_bytes() -> *const u8 {
    RESPONSE.with_borrow(|response| response.bytes.as_ptr())
}

/// How many bytes came with the last response.
#[unsafe(no_mangle)]
pub extern "C" fn reel_bytes_length() -> usize {
    RESPONSE.with_borrow(|response| response.bytes.len())
}

/// Where the text of the panic lies that ended this instance.
#[unsafe(no_mangle)]
pub extern "C" fn reel_panic() -> *const u8 {
    PANIC.lock().map_or(std::ptr::null(), |text| text.as_ptr())
}

/// How long that text is; 0 where nothing panicked.
#[unsafe(no_mangle)]
pub extern "C" fn reel_panic_length() -> usize {
    PANIC.lock().map_or(0, |text| text.len())
}
