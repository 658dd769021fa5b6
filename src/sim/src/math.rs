//! The C mathematics that the physics engine and the standard library call by symbol, defined from
//! the `libm` crate, so that a binary gives the same bits whatever C library it runs on.
//!
//! `enhanced-determinism` leaves three such calls in the engine (angular joint limits, inertia of
//! compounds, BVH building), and C libraries differ. Every binary that links the simulator gets
//! these definitions: a symbol that is defined in the executable wins over one of a shared library.
//! Functions whose result is exact (square root, rounding, remainder, fused multiply-add) are the
//! same everywhere and are left to the platform.
#![expect(
    unsafe_code,
    reason = "the linker finds a definition by its unmangled name, which Rust calls unsafe"
)]

/// Keeps the object file with the definitions in the link; every simulator calls it.
pub(crate) fn link() {
    std::hint::black_box(sinf as extern "C" fn(f32) -> f32);
}

/// The negative control of the determinism checks: in a build with this variable set to the name of
/// a function below, that function gives the next float, which the checks have to see.
const CONTROL: Option<&str> = option_env!("REEL_OFF_BY_ONE_ULP");

fn is_control(name: &str) -> bool {
    CONTROL == Some(name)
}

macro_rules! define {
    ($($name:ident($($argument:ident: $type:ty),+) -> $result:ty;)+) => {
        $(
            #[unsafe(no_mangle)]
            extern "C" fn $name($($argument: $type),+) -> $result {
                let value = libm::$name($($argument),+);
                if is_control(stringify!($name)) { value.next_up() } else { value }
            }
        )+
    };
}

define! {
    acosf(x: f32) -> f32;
    acoshf(x: f32) -> f32;
    asinf(x: f32) -> f32;
    asinhf(x: f32) -> f32;
    atan2f(y: f32, x: f32) -> f32;
    atanf(x: f32) -> f32;
    atanhf(x: f32) -> f32;
    cbrtf(x: f32) -> f32;
    cosf(x: f32) -> f32;
    coshf(x: f32) -> f32;
    exp2f(x: f32) -> f32;
    expf(x: f32) -> f32;
    expm1f(x: f32) -> f32;
    hypotf(x: f32, y: f32) -> f32;
    log10f(x: f32) -> f32;
    log1pf(x: f32) -> f32;
    log2f(x: f32) -> f32;
    logf(x: f32) -> f32;
    powf(x: f32, y: f32) -> f32;
    sinf(x: f32) -> f32;
    sinhf(x: f32) -> f32;
    tanf(x: f32) -> f32;
    tanhf(x: f32) -> f32;
    acos(x: f64) -> f64;
    acosh(x: f64) -> f64;
    asin(x: f64) -> f64;
    asinh(x: f64) -> f64;
    atan(x: f64) -> f64;
    atan2(y: f64, x: f64) -> f64;
    atanh(x: f64) -> f64;
    cbrt(x: f64) -> f64;
    cos(x: f64) -> f64;
    cosh(x: f64) -> f64;
    exp(x: f64) -> f64;
    exp2(x: f64) -> f64;
    expm1(x: f64) -> f64;
    hypot(x: f64, y: f64) -> f64;
    log(x: f64) -> f64;
    log10(x: f64) -> f64;
    log1p(x: f64) -> f64;
    log2(x: f64) -> f64;
    pow(x: f64, y: f64) -> f64;
    sin(x: f64) -> f64;
    sinh(x: f64) -> f64;
    tan(x: f64) -> f64;
    tanh(x: f64) -> f64;
}

/// Sine and cosine at once, which compilers make of two calls.
///
/// # Safety
/// Both pointers must be valid for a write.
#[unsafe(no_mangle)]
unsafe extern "C" fn sincosf(x: f32, sine: *mut f32, cosine: *mut f32) {
    let (s, c) = libm::sincosf(x);
    // SAFETY: what the caller promises.
    unsafe {
        sine.write(if is_control("sincosf") {
            s.next_up()
        } else {
            s
        });
        cosine.write(c);
    }
}

/// [`sincosf`] in double precision.
///
/// # Safety
/// Both pointers must be valid for a write.
#[unsafe(no_mangle)]
unsafe extern "C" fn sincos(x: f64, sine: *mut f64, cosine: *mut f64) {
    let (s, c) = libm::sincos(x);
    // SAFETY: what the caller promises.
    unsafe {
        sine.write(s);
        cosine.write(c);
    }
}
