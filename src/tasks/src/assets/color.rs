//! Colours of files as linear light, 0 to 1.

/// An sRGB value, 0 to 1, as linear light.
pub(crate) fn linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 {
        encoded / 12.92
    } else {
        libm::powf((encoded + 0.055) / 1.055, 2.4)
    }
}

/// Held between 0 and 1; what is no number stays none, and is refused with the mesh.
pub(crate) fn clamped(color: [f32; 3]) -> [f32; 3] {
    color.map(|channel| {
        if channel.is_finite() {
            channel.clamp(0.0, 1.0)
        } else {
            channel
        }
    })
}
