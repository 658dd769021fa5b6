//! Objects from USD: the same mesh as from other formats, what OpenUSD says of its own files, and
//! files that are refused.

use std::{fs, io::Cursor, path::Path};

use openusd::{usda, usdc::CrateWriter, usdz::ArchiveWriter};
use proptest::{prelude::*, sample::Index};
use reel_tasks::assets::{AssetFolder, MeshFormat, MeshVerdict, NoSiblings, parse};
use reel_world::Mesh;

use crate::samples;

/// The faces of [`samples::cube`].
const FACES: &str = "int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4, 2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6]";
const POINTS: &str =
    "point3f[] points = [(0,0,0), (1,0,0), (0,1,0), (1,1,0), (0,0,1), (1,0,1), (0,1,1), (1,1,1)]";
const RED: &str = "color3f[] primvars:displayColor = [(0.8, 0.2, 0.1)]";

/// A layer in metres with y up, as glTF.
fn layer(body: &str) -> String {
    format!(
        "#usda 1.0\n(\n    defaultPrim = \"Root\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n{body}\n"
    )
}

fn cube(more: &str) -> String {
    format!("def Mesh \"Cube\"\n{{\n    {POINTS}\n    {FACES}\n    {more}\n}}\n")
}

/// A layer whose default prim holds a body.
fn root(body: &str) -> String {
    layer(&format!("def Xform \"Root\"\n{{\n{body}\n}}"))
}

fn binary(text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let data = usda::parse(text).unwrap();
    CrateWriter::write(&data, &mut Cursor::new(&mut bytes)).unwrap();
    bytes
}

fn package(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut archive = ArchiveWriter::new(Cursor::new(&mut bytes));
    for (name, file) in files {
        archive.add_layer(name, file).unwrap();
    }
    archive.finish().unwrap();
    bytes
}

fn read(bytes: &[u8]) -> Result<Mesh, String> {
    parse(MeshFormat::Usd, bytes, &NoSiblings).map_err(|error| error.to_string())
}

/// The first asset of a folder of these files.
fn of_folder(files: &[(&str, &str)]) -> Result<Mesh, String> {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let asset = files[0].0.split('.').next().unwrap();
    let loaded = AssetFolder::open(folder.path())
        .unwrap()
        .load(&asset.into());
    loaded
        .map(|mesh| (*mesh.unwrap()).clone())
        .map_err(|error| error.to_string())
}

type Corners = [[f32; 3]; 3];

fn triangles(mesh: &Mesh) -> Vec<Corners> {
    let data = mesh.data();
    let corners = data.triangles.iter().map(|triangle| triangle.corners);
    corners
        .map(|corners| corners.map(|corner| data.positions[corner as usize]))
        .collect()
}

fn assert_close(found: &[Corners], wanted: &[Corners], what: &str) {
    assert_eq!(found.len(), wanted.len(), "{what}");
    for (found, wanted) in found.iter().flatten().zip(wanted.iter().flatten()) {
        for axis in 0..3 {
            let distance = (found[axis] - wanted[axis]).abs();
            assert!(distance < 2e-6, "{what}: {found:?} instead of {wanted:?}");
        }
    }
}

fn size(mesh: &Mesh) -> [f32; 3] {
    let [low, high] = mesh.bounds();
    [0, 1, 2].map(|axis| ((high[axis] - low[axis]) * 1e4).round() / 1e4)
}

#[test]
fn the_same_cube_is_the_same_mesh_in_every_format() {
    let (document, bytes) = samples::gltf(&samples::cube(), &[]);
    let glb = parse(
        MeshFormat::Glb,
        &samples::glb(&document, &bytes),
        &NoSiblings,
    )
    .unwrap();
    let obj = of_folder(&[
        (
            "cube.obj",
            &samples::obj(&samples::cube(), "mtllib cube.mtl\nusemtl red\n"),
        ),
        // The colours of OBJ are encoded as sRGB.
        ("cube.mtl", "newmtl red\nKd 0.906332 0.484529 0.349190\n"),
    ])
    .unwrap();
    let text = root(&cube(RED));
    let crate_bytes = binary(&text);
    let usd = [
        ("usda", text.clone().into_bytes()),
        ("usdc", crate_bytes.clone()),
        ("usdz", package(&[("root.usda", text.as_bytes())])),
        ("usdz of usdc", package(&[("root.usdc", &crate_bytes)])),
    ];
    let color = |mesh: &Mesh| {
        let data = mesh.data();
        assert!(data.colors.is_empty() && data.textures.is_empty());
        data.materials[usize::from(data.triangles[0].material)].color
    };
    let digest = read(&usd[0].1).unwrap().digest();
    for (format, bytes) in &usd {
        let mesh = read(bytes).unwrap();
        assert_eq!(triangles(&mesh), triangles(&glb), "{format}");
        assert_eq!(triangles(&mesh), triangles(&obj), "{format}");
        assert_eq!(mesh.bounds(), glb.bounds(), "{format}");
        assert_eq!(color(&mesh), color(&glb), "{format}");
        assert_eq!(mesh.digest(), digest, "{format}");
        for (usd, obj) in color(&mesh).iter().zip(color(&obj)) {
            assert!((usd - obj).abs() < 1e-5, "{format}");
        }
    }
}

#[test]
fn files_of_openusd_have_the_triangles_that_it_says() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/usd");
    let assets = AssetFolder::open(&folder).unwrap();
    for name in ["table", "mug"] {
        let mesh = assets.load(&name.into()).unwrap().unwrap();
        let told = fs::read_to_string(folder.join(format!("{name}.json"))).unwrap();
        let told: Vec<Corners> = serde_json::from_str(&told).unwrap();
        assert_close(&triangles(&mesh), &told, name);
    }
    let table = assets.load(&"table".into()).unwrap().unwrap();
    assert_eq!(size(&table), [1.2, 0.8, 0.75]);
    let data = table.data();
    let color =
        |triangle: usize| data.materials[usize::from(data.triangles[triangle].material)].color;
    let (wood, steel) = ([0.5, 0.25, 0.125], [0.25, 0.5, 0.75]);
    // Two faces of the board are a subset of steel, the legs are steel, the rest is the root's wood.
    assert_eq!(
        [color(0), color(3), color(4), color(12), color(59)],
        [steel, steel, wood, steel, steel]
    );
    let mug = assets.load(&"mug".into()).unwrap().unwrap();
    let data = mug.data();
    assert_eq!([data.textures[0].width, data.textures[0].height], [4, 2]);
    assert_eq!(data.textures[0].rgb[..3], [200, 30, 30]);
    // The lower left corner of a texture is the first of a face.
    let first = data.triangles[0]
        .corners
        .map(|corner| data.texture_points[corner as usize]);
    assert_eq!(first, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
}

#[test]
fn units_axes_and_transforms_are_applied() {
    let mesh = |text: &str| read(text.as_bytes()).unwrap();
    let turned = |text: &str, from: &str, to: &str| mesh(&text.replace(from, to));
    let text = root(&cube(
        "float3 xformOp:scale = (1, 2, 3)\nuniform token[] xformOpOrder = [\"xformOp:scale\"]",
    ));
    assert_eq!(size(&mesh(&text)), [1.0, 3.0, 2.0], "y up");
    assert_eq!(size(&turned(&text, "\"Y\"", "\"Z\"")), [1.0, 2.0, 3.0]);
    assert_eq!(
        size(&turned(&text, "metersPerUnit = 1", "metersPerUnit = 0.01")),
        [0.01, 0.03, 0.02]
    );
    assert_eq!(
        size(&turned(&text, "    metersPerUnit = 1\n", "")),
        [0.01, 0.03, 0.02],
        "centimetres where it does not say"
    );
    let nested = |order: &str| {
        let inner = cube(&format!(
            "double3 xformOp:translate = (1, 0, 0)\nuniform token[] xformOpOrder = [{order}\"xformOp:translate\"]"
        ));
        mesh(&root(&format!(
            "def Xform \"Arm\"\n{{\ndouble xformOp:rotateZ = 90\nfloat3 xformOp:scale = (2, 2, 2)\nuniform token[] xformOpOrder = [\"xformOp:rotateZ\", \"xformOp:scale\"]\n{inner}\n}}"
        )))
    };
    // x 1 to 2 becomes y 2 to 4, which is up.
    let [low, high] = nested("").bounds();
    assert!(
        (low[2] - 2.0).abs() < 1e-6 && (high[2] - 4.0).abs() < 1e-6,
        "{low:?} {high:?}"
    );
    let [low, high] = nested("\"!resetXformStack!\", ").bounds();
    assert_eq!(
        (low, high),
        ([1.0, -1.0, 0.0], [2.0, 0.0, 1.0]),
        "a stack that starts anew"
    );
    let left = mesh(&root(&cube("uniform token orientation = \"leftHanded\"")));
    let right = mesh(&root(&cube("")));
    for (left, right) in triangles(&left).into_iter().zip(triangles(&right)) {
        assert_eq!(left, [right[0], right[2], right[1]]);
    }
}

#[test]
fn layers_of_the_folder_compose() {
    let leg = root(&cube(RED));
    let table = |arcs: &str| root(&format!("def \"Leg\" ({arcs})\n{{\n}}"));
    let whole = read(leg.as_bytes()).unwrap();
    for (what, arcs) in [
        ("a reference", "prepend references = @./parts/leg.usda@"),
        ("one without a dot", "prepend references = @parts/leg.usda@"),
        (
            "a way around",
            "prepend references = @parts/../parts/leg.usda@",
        ),
        ("a payload", "payload = @parts/leg.usda@</Root>"),
        (
            "an instance",
            "instanceable = true\nprepend references = @parts/leg.usda@",
        ),
    ] {
        let mesh = of_folder(&[("table.usda", &table(arcs)), ("parts/leg.usda", &leg)]);
        assert_eq!(mesh.map(|mesh| mesh.digest()), Ok(whole.digest()), "{what}");
    }
    // References between layers below are from where the layer is.
    let middle = root("def \"Part\" (prepend references = @./deep/leg.usda@)\n{\n}");
    let files = [
        (
            "table.usda",
            &*table("prepend references = @parts/middle.usda@"),
        ),
        ("parts/middle.usda", &*middle),
        ("parts/deep/leg.usda", &*leg),
    ];
    assert_eq!(of_folder(&files).unwrap().digest(), whole.digest());
    let layered = leg.replace("(\n", "(\n    subLayers = [@./color.usda@]\n");
    let color = layer(
        "over \"Root\"\n{\nover \"Cube\"\n{\ncolor3f[] primvars:displayColor = [(0, 0, 1)]\n}\n}",
    );
    let files = [("a.usda", &*layered), ("color.usda", &*color)];
    assert_eq!(
        of_folder(&files).unwrap().digest(),
        whole.digest(),
        "a weaker layer"
    );
    let inner = package(&[
        (
            "root.usda",
            table("prepend references = @./leg.usda@").as_bytes(),
        ),
        ("leg.usda", leg.as_bytes()),
    ]);
    assert_eq!(
        read(&inner).unwrap().digest(),
        whole.digest(),
        "in a package"
    );
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("inner.usdz"), inner).unwrap();
    fs::write(
        folder.path().join("outer.usda"),
        table("prepend references = @inner.usdz@"),
    )
    .unwrap();
    let outer = AssetFolder::open(folder.path())
        .unwrap()
        .load(&"outer".into());
    assert_eq!(
        outer.unwrap().unwrap().digest(),
        whole.digest(),
        "of a package"
    );
}

#[test]
fn colours_are_those_of_meshes_faces_points_and_materials() {
    let colors = |more: &str| {
        let mesh = read(root(&cube(more)).as_bytes()).unwrap();
        let data = mesh.data().clone();
        (data.positions.len(), data.colors, data.materials[0].color)
    };
    assert_eq!(colors(RED), (8, vec![], [0.8, 0.2, 0.1]));
    assert_eq!(colors("").2, [0.6; 3], "a plain grey");
    let of_faces = "color3f[] primvars:displayColor = [(1,0,0), (0,1,0)] (interpolation = \"uniform\")\nint[] primvars:displayColor:indices = [0, 0, 0, 0, 0, 1]";
    let (vertices, list, _) = colors(of_faces);
    // The last face has four vertices of its own.
    assert_eq!(
        (
            vertices,
            list.iter()
                .filter(|color| **color == [0.0, 1.0, 0.0])
                .count()
        ),
        (12, 4)
    );
    let of_points = "color3f[] primvars:displayColor = [(1,0,0),(0,1,0),(0,0,1),(1,1,0),(1,0,1),(0,1,1),(0,0,0),(1,1,1)] (interpolation = \"vertex\")";
    let (vertices, list, material) = colors(of_points);
    assert_eq!(
        (vertices, list.len(), list[0], material),
        (8, 8, [1.0, 0.0, 0.0], [1.0; 3])
    );
    let look = "def Material \"Look\"\n{\ntoken outputs:surface.connect = </Root/Look/S.outputs:surface>\ndef Shader \"S\"\n{\nuniform token info:id = \"UsdPreviewSurface\"\ncolor3f inputs:diffuseColor = (0.1, 0.9, 0.1)\ntoken outputs:surface\n}\n}\n";
    let bound = root(&format!(
        "{look}rel material:binding = </Root/Look>\n{}",
        cube(of_points)
    ));
    let bound = read(bound.as_bytes()).unwrap();
    assert_eq!(
        (bound.data().materials[0].color, bound.data().colors.len()),
        ([0.1, 0.9, 0.1], 0),
        "a material of the root goes first"
    );
    let inherited = read(root(&format!("{RED}\n{}", cube(""))).as_bytes()).unwrap();
    assert_eq!(inherited.data().materials[0].color, [0.8, 0.2, 0.1]);
}

#[test]
fn what_does_not_show_is_left_out() {
    let shown = read(root(&cube(RED)).as_bytes()).unwrap();
    let far = cube("")
        .replace("\"Cube\"", "\"Far\"")
        .replace("(1,1,1)", "(9,9,9)");
    for hidden in [
        "token visibility = \"invisible\"",
        "uniform token purpose = \"guide\"",
        "uniform token purpose = \"proxy\"",
    ] {
        let text = root(&format!(
            "{}def Xform \"Hidden\"\n{{\n{hidden}\n{far}}}",
            cube(RED)
        ));
        assert_eq!(
            read(text.as_bytes()).unwrap().digest(),
            shown.digest(),
            "{hidden}"
        );
    }
    let class = format!("{}\nclass Xform \"Class\"\n{{\n{far}}}", root(&cube(RED)));
    assert_eq!(read(class.as_bytes()).unwrap().digest(), shown.digest());
    let hole = read(root(&cube("int[] holeIndices = [0, 5]")).as_bytes()).unwrap();
    assert_eq!(hole.data().triangles.len(), 8);
}

#[test]
fn unsound_files_are_refused_with_prim_and_reason() {
    let refs = |arcs: &str| root(&format!("def \"Leg\" ({arcs})\n{{\n}}"));
    let many = format!(
        "int[] faceVertexCounts = [{}3]\nint[] faceVertexIndices = [{}0, 1, 2]",
        "3, ".repeat(100_000),
        "0, 1, 2, ".repeat(100_000)
    );
    let deep = "def Xform \"A\"\n{\n".repeat(150) + &"}\n".repeat(150);
    let prims: String = (0..10_001)
        .map(|index| format!("def Xform \"P{index}\" {{}}\n"))
        .collect();
    let cases = [
        (
            "outside",
            refs("references = @../out.usda@</Root>"),
            "/Root/Leg: @../out.usda@ is missing: it names ../out.usda, which is not in its folder",
        ),
        (
            "absolute",
            refs("references = @/etc/passwd@</Root>"),
            "which is not in its folder",
        ),
        (
            "network",
            refs("references = @https://example.org/a.usda@</Root>"),
            "which is not in its folder",
        ),
        (
            "lost",
            refs("references = @gone.usda@</Root>"),
            "/Root/Leg: @gone.usda@ is missing: the file gone.usda cannot be read",
        ),
        (
            "prim",
            refs("payload = @leg.usda@</Nothing>"),
            "/Root/Leg: unresolved Payload prim path",
        ),
        (
            "torn_layer",
            refs("references = @torn.usda@</Root>"),
            "/Root/Leg: malformed Reference layer",
        ),
        (
            "sublayer",
            root(&cube("")).replace(
                "(\n    default",
                "(\n    subLayers = [@gone.usda@]\n    default",
            ),
            "@gone.usda@ is missing",
        ),
        (
            "loop",
            refs("references = @loop.usda@</Root>"),
            "lead back to itself",
        ),
        (
            "itself",
            refs("references = </Root>"),
            "lead back to itself",
        ),
        ("many", root(&cube("").replace(FACES, &many)), "decimate it"),
        (
            "nan",
            root(&cube("").replace("(1,1,1)]", "(1,1,nan)]")),
            "/Root/Cube: points[7] is not finite",
        ),
        (
            "index",
            root(&cube("").replace("7, 6]", "7, 8]")),
            "/Root/Cube: faceVertexIndices has 8, and there are 8 points",
        ),
        (
            "negative",
            root(&cube("").replace("7, 6]", "7, -6]")),
            "/Root/Cube: faceVertexIndices has a number below 0",
        ),
        (
            "counts",
            root(&cube("").replace("[4, 4,", "[4, 5,")),
            "do not belong together",
        ),
        (
            "line",
            root(&cube("").replace("[4, 4,", "[2, 6,")),
            "faceVertexCounts has 2",
        ),
        (
            "no_points",
            root(&cube("").replace(POINTS, "")),
            "/Root/Cube: it has no points",
        ),
        (
            "colors",
            root(&cube(
                "color3f[] primvars:displayColor = [(1,0,0), (0,1,0)] (interpolation = \"vertex\")",
            )),
            "primvars:displayColor has too few values",
        ),
        ("empty", layer(""), "it has no triangles"),
        ("nothing", String::new(), "usdcat"),
        (
            "sphere",
            root("def Sphere \"Ball\" {}"),
            "/Root/Ball: a Sphere is not read; convert it to a mesh",
        ),
        (
            "units",
            root(&cube("")).replace("metersPerUnit = 1", "metersPerUnit = -1"),
            "metersPerUnit: must be above 0",
        ),
        (
            "operation",
            root(&cube(
                "float xformOp:shear = 1\nuniform token[] xformOpOrder = [\"xformOp:shear\"]",
            )),
            "/Root/Cube: xformOp:shear is no transform operation",
        ),
        ("deep", layer(&deep), "nested deeper than 100"),
        (
            "brackets",
            format!("#usda 1.0\n{}", "def \"a\" {\n".repeat(5000)),
            "brackets nest deeper",
        ),
        ("prims", layer(&prims), "prims, and at most 10000"),
        ("half", root(&cube(""))[..200].to_owned(), "usdcat"),
        (
            "tiny",
            root(&cube("")).replace("metersPerUnit = 1", "metersPerUnit = 1e-9"),
            "scale it to metres",
        ),
    ];
    let mut wrong = Vec::new();
    for (name, text, wanted) in cases {
        let file = format!("{name}.usda");
        let files = [
            (&*file, &*text),
            ("leg.usda", &*root(&cube(""))),
            ("torn.usda", "#usda 1.0\ndef \"a\" {"),
        ];
        let found = of_folder(&files).unwrap_err();
        if !found.contains(wanted) {
            wrong.push(format!("{name}: {found}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The layers of an object count together.
#[test]
fn layers_of_more_bytes_than_a_file_may_have_are_refused() {
    let large = format!("{}# {}", root(&cube("")), "x".repeat(33 << 20));
    let both = "def \"A\" (references = @a.usda@) {}\ndef \"B\" (references = @b.usda@) {}";
    let files = [
        ("all.usda", &*root(both)),
        ("a.usda", &*large),
        ("b.usda", &*large),
    ];
    let found = of_folder(&files).unwrap_err();
    assert!(
        found.contains("bytes, with the files that it names, and at most 67108864"),
        "{found}"
    );
}

#[test]
fn unsound_packages_are_refused() {
    let text = root(&cube(RED));
    let whole = package(&[("root.usda", text.as_bytes())]);
    let mut compressed = whole.clone();
    let directory = whole
        .windows(4)
        .position(|bytes| bytes == b"PK\x01\x02")
        .unwrap();
    compressed[directory + 10] = 8;
    let escaping = text.replace(
        "def Xform \"Root\"",
        "def Xform \"Root\" (references = @../leg.usda@)",
    );
    for (what, bytes, wanted) in [
        ("compressed", compressed, "compressed files"),
        (
            "torn",
            whole[..whole.len() - 30].to_vec(),
            "no sound usdz package",
        ),
        (
            "without layers",
            package(&[("notes.txt", b"none")]),
            "holds no .usd",
        ),
        (
            "leaving itself",
            package(&[("root.usda", escaping.as_bytes())]),
            "not in its folder",
        ),
    ] {
        let found = read(&bytes).unwrap_err();
        assert!(found.contains(wanted), "{what}: {found}");
    }
}

/// A count of a binary layer may say anything: it is refused before anything is allocated.
#[test]
fn no_count_of_a_binary_layer_is_trusted() {
    let whole = fixture("table.usdc");
    for length in (0..whole.len()).step_by(7) {
        let found = read(&whole[..length]);
        assert!(found.is_err(), "of {length} bytes");
    }
    for at in (0..whole.len() - 8).step_by(3) {
        for count in [1_u64 << 32, 1 << 45, u64::MAX] {
            let mut bytes = whole.clone();
            bytes[at..at + 8].copy_from_slice(&count.to_le_bytes());
            drop(read(&bytes));
        }
    }
}

#[test]
fn a_folder_names_files_of_usd_as_the_others() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("mug.usda", root(&cube(RED))),
        ("plate.usd", root(&cube(RED))),
        ("pan.usda", root("")),
        ("mug.obj", samples::obj(&samples::cube(), "")),
    ] {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let listed = AssetFolder::open(folder.path()).unwrap().check();
    let verdict = |name: &str| {
        &listed
            .iter()
            .find(|file| file.file == name)
            .unwrap()
            .verdict
    };
    assert!(
        matches!(verdict("plate.usd"), MeshVerdict::Loads(survey) if survey.watertight && survey.triangles == 12)
    );
    assert_eq!(
        *verdict("mug.usda"),
        MeshVerdict::Hidden {
            by: "mug.obj".into()
        }
    );
    assert!(
        matches!(verdict("pan.usda"), MeshVerdict::Refused { reason } if reason.contains("no triangles"))
    );
}

fn fixture(name: &str) -> Vec<u8> {
    fs::read(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data/usd")
            .join(name),
    )
    .unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    /// Bytes changed, taken out or put in anywhere: a mesh, or a reason.
    #[test]
    fn no_bytes_of_usd_make_it_panic(
        which in 0..3usize,
        edits in prop::collection::vec((any::<Index>(), any::<u8>(), 0..3u8), 1..6),
    ) {
        let mut bytes = match which {
            0 => fixture("table.usdc"),
            1 => fixture("mug.usdz"),
            _ => root(&cube(RED)).into_bytes(),
        };
        for (at, byte, edit) in edits {
            let at = at.index(bytes.len());
            match edit {
                0 => bytes[at] = byte,
                1 => drop(bytes.remove(at)),
                _ => bytes.insert(at, byte),
            }
        }
        if let Err(refusal) = read(&bytes) {
            prop_assert!(!refusal.is_empty());
        }
    }
}
