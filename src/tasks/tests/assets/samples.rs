//! Files of assets, made here: sound ones, and every way of being none that we know.

use std::{f32::consts::TAU, fs, path::Path};

use serde_json::{Value, json};

/// Vertices, texture points and triangles.
#[derive(Clone, Default)]
pub struct Shape {
    pub points: Vec<[f32; 3]>,
    pub uv: Vec<[f32; 2]>,
    pub triangles: Vec<[u32; 3]>,
}

/// A closed box of unit sides on the ground, y up.
pub fn cube() -> Shape {
    let mut shape = Shape::default();
    for corner in 0..8u8 {
        shape
            .points
            .push([0, 1, 2].map(|axis| f32::from(corner >> axis & 1)));
        shape
            .uv
            .push([f32::from(corner & 1), f32::from(corner >> 1 & 1)]);
    }
    for [a, b, c, d] in [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ] {
        shape.triangles.extend([[a, b, c], [a, c, d]]);
    }
    shape
}

/// A vase: a profile turned around y, open above, with texture points all over.
pub fn vase() -> Shape {
    const AROUND: u32 = 48;
    let profile = [
        [0.0, 0.0],
        [0.3, 0.0],
        [0.42, 0.3],
        [0.45, 0.55],
        [0.3, 0.95],
        [0.2, 1.15],
        [0.3, 1.4],
    ];
    let mut shape = Shape::default();
    for (row, [radius, height]) in profile.into_iter().enumerate() {
        for step in 0..=AROUND {
            let (sine, cosine) = (step as f32 / AROUND as f32 * TAU).sin_cos();
            shape.points.push([radius * sine, height, radius * cosine]);
            shape
                .uv
                .push([step as f32 / AROUND as f32, 1.0 - row as f32 / 6.0]);
        }
    }
    for row in 0..6 {
        for step in 0..AROUND {
            let at = row * (AROUND + 1) + step;
            shape.triangles.extend([
                [at, at + 1, at + AROUND + 2],
                [at, at + AROUND + 2, at + AROUND + 1],
            ]);
        }
    }
    shape
}

/// A shape as an OBJ file.
pub fn obj(shape: &Shape, head: &str) -> String {
    let mut text = format!("# made by a test\n{head}");
    for [x, y, z] in &shape.points {
        text.push_str(&format!("v {x} {y} {z}\n"));
    }
    for [u, v] in &shape.uv {
        text.push_str(&format!("vt {u} {}\n", 1.0 - v));
    }
    for triangle in &shape.triangles {
        let [a, b, c] = triangle.map(|corner| corner + 1);
        text.push_str(&format!("f {a}/{a} {b}/{b} {c}/{c}\n"));
    }
    text
}

/// A shape as a glTF document and its binary part: indices, positions, texture points, then
/// what else there is.
pub fn gltf(shape: &Shape, more: &[u8]) -> (Value, Vec<u8>) {
    let mut binary: Vec<u8> = shape
        .triangles
        .iter()
        .flatten()
        .flat_map(|index| index.to_le_bytes())
        .collect();
    let points_at = binary.len();
    binary.extend(
        shape
            .points
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes()),
    );
    let uv_at = binary.len();
    binary.extend(
        shape
            .uv
            .iter()
            .flatten()
            .flat_map(|value| value.to_le_bytes()),
    );
    let more_at = binary.len();
    binary.extend(more);
    let axis = |axis: usize, pick: fn(f32, f32) -> f32| {
        shape
            .points
            .iter()
            .map(|point| point[axis])
            .reduce(pick)
            .unwrap_or(0.0)
    };
    let corner = |pick: fn(f32, f32) -> f32| [0, 1, 2].map(|index| axis(index, pick));
    let document = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 1, "TEXCOORD_0": 2 }, "indices": 0, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.2, 0.1, 1.0] } }],
        "accessors": [
            { "bufferView": 0, "componentType": 5125, "count": shape.triangles.len() * 3, "type": "SCALAR" },
            { "bufferView": 1, "componentType": 5126, "count": shape.points.len(), "type": "VEC3",
              "min": corner(f32::min), "max": corner(f32::max) },
            { "bufferView": 2, "componentType": 5126, "count": shape.uv.len(), "type": "VEC2" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": points_at },
            { "buffer": 0, "byteOffset": points_at, "byteLength": uv_at - points_at },
            { "buffer": 0, "byteOffset": uv_at, "byteLength": more_at - uv_at },
            { "buffer": 0, "byteOffset": more_at, "byteLength": more.len().max(1) },
        ],
        "buffers": [{ "byteLength": binary.len() }],
    });
    (document, binary)
}

/// The document with the image behind the vertices as the texture of its material.
pub fn textured(shape: &Shape, image: &[u8]) -> (Value, Vec<u8>) {
    let (mut document, binary) = gltf(shape, image);
    document["images"] = json!([{ "bufferView": 3, "mimeType": "image/png" }]);
    document["textures"] = json!([{ "source": 0 }]);
    document["materials"] =
        json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
    (document, binary)
}

/// A binary glTF file.
pub fn glb(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let number = |length: usize| u32::try_from(length).unwrap().to_le_bytes();
    let length = number(12 + 8 + text.len() + 8 + binary.len());
    let json = [&number(text.len()), &b"JSON"[..], &text].concat();
    let bin = [&number(binary.len()), &b"BIN\0"[..], &binary].concat();
    [&b"glTF"[..], &number(2), &length, &json, &bin].concat()
}

/// The two as one.
fn packed((document, binary): (Value, Vec<u8>)) -> Vec<u8> {
    glb(&document, &binary)
}

/// A PNG file, each pixel by its place.
pub fn png(width: u32, height: u32, pixel: impl Fn(u32, u32) -> [u8; 3]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let rgb: Vec<u8> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .flat_map(|(x, y)| pixel(x, y))
        .collect();
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&rgb)
        .unwrap();
    bytes
}

/// White and blue bands with a red square: up and down, left and right can be told apart.
pub fn pattern() -> Vec<u8> {
    png(256, 256, |x, y| match (x, y) {
        (40..120, 150..220) => [200, 30, 30],
        _ if (y / 24) % 2 == 0 => [245, 244, 238],
        _ => [30, 60, 150],
    })
}

/// A PNG that says it has so many pixels and holds none.
fn bomb(side: u32) -> Vec<u8> {
    let mut bytes = png(1, 1, |_, _| [0; 3]);
    bytes[16..20].copy_from_slice(&side.to_be_bytes());
    bytes[20..24].copy_from_slice(&side.to_be_bytes());
    let mut crc = u32::MAX;
    for byte in &bytes[12..29] {
        crc ^= u32::from(*byte);
        (0..8).for_each(|_| {
            crc = if crc & 1 == 1 {
                crc >> 1 ^ 0xedb8_8320
            } else {
                crc >> 1
            }
        });
    }
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    bytes
}

fn data_uri(kind: &str, bytes: &[u8]) -> String {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    format!("data:{kind};base64,{}", STANDARD.encode(bytes))
}

/// Writes all of them, and says of each what comes of it: nothing where it loads, or a
/// part of the reason.
pub fn write(folder: &Path) -> Vec<(&'static str, Option<&'static str>)> {
    let mut expected = Vec::new();
    let mut file = |name: &'static str, bytes: &[u8], refused: Option<&'static str>| {
        fs::write(folder.join(name), bytes).unwrap();
        expected.push((name, refused));
    };
    let changed = |(mut document, binary): (Value, Vec<u8>), change: &dyn Fn(&mut Value)| {
        change(&mut document);
        glb(&document, &binary)
    };
    let plain = || gltf(&cube(), &[]);
    let (document, binary) = plain();
    fs::write(
        folder.join("painted.mtl"),
        "newmtl skin\nKd 0.5 0.5 0.5\nmap_Kd -clamp off band.png\n",
    )
    .unwrap();
    fs::write(folder.join("band.png"), pattern()).unwrap();
    fs::write(folder.join("lost.mtl"), "newmtl skin\nmap_Kd nowhere.png\n").unwrap();
    fs::write(folder.join("buffer.bin"), &binary).unwrap();

    // Sound ones.
    file("obj_plain.obj", obj(&cube(), "").as_bytes(), None);
    file(
        "obj_textured.obj",
        obj(&vase(), "mtllib painted.mtl\nusemtl skin\n").as_bytes(),
        None,
    );
    let colored = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 0 0 1 1 1 1\nf 1 3 2\nf 1 2 4\nf -4 -1 -2\nf 2 3 4\n";
    file("obj_colored.obj", colored.as_bytes(), None);
    file("glb_plain.glb", &glb(&document, &binary), None);
    let (document_textured, binary_textured) = textured(&vase(), &pattern());
    file(
        "glb_textured.glb",
        &glb(&document_textured, &binary_textured),
        None,
    );
    let mut beside = document.clone();
    beside["buffers"][0]["uri"] = json!("buffer.bin");
    file("gltf_beside.gltf", beside.to_string().as_bytes(), None);
    let mut embedded = document.clone();
    embedded["buffers"][0]["uri"] = json!(data_uri("application/octet-stream", &binary));
    file("gltf_embedded.gltf", embedded.to_string().as_bytes(), None);
    let turned = json!([{ "children": [1], "scale": [2, 2, 2] }, { "mesh": 0, "rotation": [0, 0.6, 0, 0.8], "translation": [1, 0, 0] }]);
    file(
        "glb_nodes.glb",
        &changed(plain(), &|it| it["nodes"] = turned.clone()),
        None,
    );
    let mut winged = cube();
    winged.triangles.extend([[0, 7, 1], [0, 7, 2], [0, 7, 4]]);
    file("not_manifold.obj", obj(&winged, "").as_bytes(), None);
    file(
        "sheet.obj",
        b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n",
        None,
    );

    // Nothing in them, or not what their names say.
    file("empty_text.obj", b"", Some("no triangles"));
    file("empty.glb", b"", Some("no sound glTF"));
    file(
        "only_points.obj",
        b"v 0 0 0\nv 1 0 0\np 1 2\nl 1 2\n",
        Some("no triangles"),
    );
    file(
        "no_meshes.gltf",
        br#"{"asset": {"version": "2.0"}}"#,
        Some("no triangles"),
    );
    file(
        "header.glb",
        b"glTF\x02\0\0\0",
        Some("ends in its first chunk"),
    );
    file(
        "version.glb",
        b"glTF\x01\0\0\0\x14\0\0\0",
        Some("glTF of version 1"),
    );
    file("text.obj", &[0xff, 0xfe, 0x00, 0x81], Some("it is no text"));
    let whole = glb(&document, &binary);
    file(
        "truncated.glb",
        &whole[..whole.len() - 40],
        Some("ends in its second chunk"),
    );
    file(
        "short_buffer.glb",
        &glb(&document, &binary[..60]),
        Some("buffer 0 has 60 bytes"),
    );
    file(
        "words.obj",
        b"v 0 zero 0\n",
        Some("line 1: 'zero' is not a number"),
    );

    // Numbers that mean nothing.
    file(
        "nan_text.obj",
        b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        Some("not finite"),
    );
    let mut infinite = cube();
    infinite.points[3][1] = f32::NAN;
    file("nan.glb", &packed(gltf(&infinite, &[])), Some("not finite"));
    file(
        "index_text.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
        Some("line 4: there is no vertex 4"),
    );
    file(
        "index_huge.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9223372036854775807\n",
        Some("there is no vertex"),
    );
    let mut outside = cube();
    outside.triangles[0][0] = 99;
    file(
        "index.glb",
        &packed(gltf(&outside, &[])),
        Some("refers to vertex 99"),
    );
    file(
        "huge_coordinates.obj",
        b"v 0 0 0\nv 1e30 0 0\nv 0 1e30 0\nf 1 2 3\n",
        Some("scale it to metres"),
    );
    file(
        "tiny.obj",
        b"v 0 0 0\nv 1e-9 0 0\nv 0 1e-9 0\nf 1 2 3\n",
        Some("scale it to metres"),
    );
    file(
        "zero_area.obj",
        b"v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n",
        Some("no area"),
    );

    // Too much.
    let many: String = (0..100_001).map(|_| "f 1 2 3\n").collect();
    file(
        "many_triangles.obj",
        format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{many}").as_bytes(),
        Some("decimate it"),
    );
    let count = |it: &mut Value| it["accessors"][1]["count"] = json!(4_000_000_000u32);
    file(
        "many_vertices.glb",
        &changed(plain(), &count),
        Some("decimate it"),
    );
    let far = |it: &mut Value| it["accessors"][0]["byteOffset"] = json!(u64::MAX / 2);
    file(
        "far_offset.glb",
        &changed(plain(), &far),
        Some("ends behind its data"),
    );
    file(
        "texture_bomb.glb",
        &packed(textured(&cube(), &bomb(60_000))),
        Some("60000 pixels on one side"),
    );
    let large = fs::File::create(folder.join("huge_file.obj")).unwrap();
    large.set_len(65 << 20).unwrap();
    expected.push(("huge_file.obj", Some("bytes, and at most")));

    // What lies elsewhere, or nowhere.
    let mut file = |name: &'static str, bytes: &[u8], refused: Option<&'static str>| {
        fs::write(folder.join(name), bytes).unwrap();
        expected.push((name, refused));
    };
    let uri = |uri: &str| {
        let mut document = document.clone();
        document["buffers"][0]["uri"] = json!(uri);
        document.to_string().into_bytes()
    };
    file(
        "absolute.gltf",
        &uri("/etc/hostname"),
        Some("not in its folder"),
    );
    file(
        "above.gltf",
        &uri("%2e%2e/buffer.bin"),
        Some("not in its folder"),
    );
    file(
        "network.gltf",
        &uri("https://example.org/buffer.bin"),
        Some("not in its folder"),
    );
    file(
        "missing_buffer.gltf",
        &uri("nothing.bin"),
        Some("nothing.bin cannot be read"),
    );
    file(
        "missing_texture.obj",
        obj(&cube(), "mtllib lost.mtl\nusemtl skin\n").as_bytes(),
        Some("nowhere.png cannot be read"),
    );
    file(
        "missing_materials.obj",
        obj(&cube(), "mtllib none.mtl\n").as_bytes(),
        Some("none.mtl cannot be read"),
    );
    file(
        "broken_texture.glb",
        &packed(textured(&cube(), &pattern()[..400])),
        Some("no sound PNG"),
    );
    file(
        "other_texture.glb",
        &packed(textured(&cube(), b"GIF89a...")),
        Some("neither PNG nor JPEG"),
    );

    // What a document may say and should not.
    let cycle = json!([{ "mesh": 0, "children": [1] }, { "children": [0] }]);
    file(
        "cycle.glb",
        &changed(plain(), &|it| it["nodes"] = cycle.clone()),
        Some("of itself"),
    );
    file(
        "no_such_mesh.glb",
        &changed(plain(), &|it| it["nodes"][0]["mesh"] = json!(7)),
        Some("no sound glTF document"),
    );
    let draco = |it: &mut Value| it["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    file(
        "draco.glb",
        &changed(plain(), &draco),
        Some("KHR_draco_mesh_compression"),
    );
    file(
        "kind.glb",
        &changed(plain(), &|it| it["accessors"][1]["type"] = json!("VEC2")),
        Some("components instead of 3"),
    );
    file(
        "stride.glb",
        &changed(plain(), &|it| {
            it["bufferViews"][1]["byteStride"] = json!(252)
        }),
        Some("ends behind its data"),
    );
    expected
}
