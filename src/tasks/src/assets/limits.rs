//! What a folder of assets may hold, so that no file takes more memory than it is worth. Those of a
//! mesh itself stand with [`reel_world::mesh`].

/// Most bytes of one file.
pub const FILE_BYTES_MAX: u64 = 64 << 20;
/// Most bytes of a line of an OBJ file.
pub const LINE_BYTES_MAX: usize = 64 << 10;
/// Most pixels of one side of a texture.
pub const TEXTURE_SIDE_MAX: u32 = 4096;
/// Most nodes of glTF, or prims of USD, that a file is walked through.
pub const NODES_MAX: usize = 10_000;
/// Deepest nesting of prims in a USD stage.
pub const USD_DEPTH_MAX: usize = 100;
