//! Recordings that are torn, damaged, out of order or no recordings: what can be read is read,
//! the rest is named.

use proptest::prelude::*;

use super::*;

#[test]
fn out_of_order() {
    let place = Place::new();
    let (whole, _) = place.said(&episode());
    let whole = bytes(&whole);
    let mut messages = episode();
    messages.reverse();
    let (recording, _) = place.said(&messages);
    assert!(bytes(&recording) == whole);
}

#[test]
fn a_clock_that_is_set_back_goes_on() {
    let place = Place::new();
    let (_, whole) = place.said(&episode());
    let mut messages = episode();
    let set_back = messages.iter().position(|it| it.topic == "/primitive");
    for message in &mut messages[set_back.unwrap() + 2..] {
        message.ns -= 3_500_000_000;
    }
    let (recording, trace) = place.said(&messages);
    let losses: Vec<String> = recording.losses.iter().map(ToString::to_string).collect();
    assert_eq!(losses.len(), 1, "{losses:?}");
    assert!(
        losses[0].contains("the clock goes back by 3.4"),
        "{losses:?}"
    );
    let told = &trace.header.policy.parameters["losses"];
    assert!(told[0].as_str().unwrap().contains("the clock goes back"));
    assert_eq!(trace.steps.len(), whole.steps.len());
    for (step, before) in trace.steps.iter().zip(&whole.steps) {
        assert_eq!(step.input, before.input);
        assert_eq!(step.robot.path_length_m, before.robot.path_length_m);
    }
}

#[test]
fn torn_anywhere_up_to_the_tear() {
    let place = Place::new();
    let path = place.path("whole.mcap");
    bags::write(&path, &without_images(), Encoding::Cdr);
    let (_, whole) = place.import(&path);
    let bytes = fs::read(&path).unwrap();
    let torn = place.path("torn.mcap");
    let mapping = Mapping::parse(MAPPING).unwrap();
    let mut most = 0;
    for length in (0..bytes.len() - 1).step_by(bytes.len() / 60) {
        fs::write(&torn, &bytes[..length]).unwrap();
        let Ok(recording) = import(&torn, &mapping, &place.out, &PLAIN) else {
            continue;
        };
        // Where only the index is missing nothing else is.
        assert_eq!(
            recording.losses.len(),
            usize::from(
                recording
                    .losses
                    .iter()
                    .any(|loss| loss.message.contains("breaks off"))
            )
        );
        let trace = healthy(&recording.episodes[0].trace);
        assert!(
            trace.steps.len() >= most,
            "{length} bytes hold fewer steps than fewer bytes"
        );
        most = trace.steps.len();
        for (step, before) in trace.steps.iter().zip(&whole.steps).rev().skip(1) {
            assert_eq!(
                (&step.input, &step.outcome),
                (&before.input, &before.outcome)
            );
        }
        if most < 7 {
            assert_eq!(
                recording.losses.len(),
                1,
                "{length} bytes: {:?}",
                recording.losses
            );
            assert_eq!(recording.episodes[0].end, EndReason::Aborted);
        }
    }
    assert_eq!(most, 7);
}

#[test]
fn a_damaged_chunk_costs_its_messages() {
    let place = Place::new();
    let path = place.path("damaged.mcap");
    // Chunks of one image each, with small ones between.
    let mut messages = episode();
    messages.truncate(9);
    messages.extend((0..8).flat_map(|number| {
        [
            odometry(3_000 + number * 100, 3.0, 4.0 + number as f64),
            jpeg(3_050 + number * 100, (640, 480), [number as u8 * 9, 99, 1]),
        ]
    }));
    messages.push(result(9_000, "a", "arrived", true));
    bags::write_with(&path, &messages, Encoding::Protobuf, None);
    let mut bytes = fs::read(&path).unwrap();
    let data = STANDARD
        .decode(messages[16].value["data"].as_str().unwrap())
        .unwrap();
    let at = bytes
        .windows(data.len())
        .position(|window| window == data)
        .unwrap();
    bytes[at + data.len() / 2] ^= 0x40;
    fs::write(&path, &bytes).unwrap();
    let (recording, trace) = place.import(&path);
    let [loss] = &recording.losses[..] else {
        panic!("{:?}", recording.losses)
    };
    assert_eq!(loss.file, path);
    assert!(
        loss.message.starts_with("the chunk at byte ")
            && loss.message.contains("with the messages from 179000000"),
        "{}",
        loss.message
    );
    assert_eq!(
        (trace.steps.len(), trace.steps[0].outcome.text.as_str()),
        (1, "arrived")
    );
    assert!(
        (8..11).contains(&trace.robot.odometry.len()),
        "{}",
        trace.robot.odometry.len()
    );
}

#[test]
fn gibberish_is_counted_by_topic() {
    let place = Place::new();
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Cdr] {
        let mut messages = episode();
        for index in [7, 8, 12] {
            messages[index].instead = Some(b"\xff\xfe gibberish".to_vec());
        }
        let path = place.path("gibberish.mcap");
        bags::write(&path, &messages, encoding);
        let (recording, trace) = place.import(&path);
        let [odometry, result] = &recording.losses[..] else {
            panic!("{:?}", recording.losses)
        };
        assert_eq!((&odometry.file, &result.file), (&path, &path));
        let first = "2 of the messages on /odom cannot be read and are left out, the first at 1790000001.500000000 s (no ";
        assert!(odometry.message.starts_with(first), "{}", odometry.message);
        assert!(
            result
                .message
                .starts_with("1 of the messages on /result cannot be read"),
            "{}",
            result.message
        );
        assert_eq!(
            (trace.steps.len(), trace.steps[0].outcome.error),
            (7, Some(ErrorCode::BackendError))
        );
        assert_eq!(
            trace.steps[0].outcome.text,
            "no result of this call was recorded"
        );
        assert_eq!(trace.steps[1].outcome.error, Some(ErrorCode::SkillFailed));
    }
    // A message that can be read and says nothing.
    let mut messages = episode();
    messages[6].value = json!({"id": "a", "arguments": "{}"});
    messages.push(result(20_000, "z", "", true));
    let (recording, trace) = place.said(&messages);
    assert_eq!(trace.steps.len(), 6);
    let losses: Vec<&str> = recording
        .losses
        .iter()
        .map(|loss| loss.message.as_str())
        .collect();
    assert_eq!(losses.len(), 2, "{losses:?}");
    assert_eq!(
        losses[0],
        "a result that no call waits for, at 1790000002.500000000 s"
    );
    assert!(
        losses[1].contains("(a call without tool (looked for at '/tool', '/tool_name', '/name'))"),
        "{losses:?}"
    );
}

#[test]
fn a_recording_without_an_episode_says_what_it_holds() {
    let place = Place::new();
    let path = place.path("empty.mcap");
    bags::write(
        &path,
        &[
            odometry(0, 0.0, 0.0),
            said(1, "/diagnostics", json!({"data": ""})),
        ],
        Encoding::Json,
    );
    let refused = |path: &Path| {
        import(path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN)
            .unwrap_err()
            .to_string()
    };
    assert!(
        refused(&path).contains("its topics are /diagnostics, /odom"),
        "{}",
        refused(&path)
    );
    bags::write(&path, &[], Encoding::Json);
    assert!(
        refused(&path).contains("it holds no message"),
        "{}",
        refused(&path)
    );
    fs::write(&path, "no bag at all").unwrap();
    assert!(
        refused(&path).contains("it is no MCAP file"),
        "{}",
        refused(&path)
    );
    let database = place.path("drive_0.db3");
    fs::write(&database, "SQLite format 3").unwrap();
    assert!(
        refused(&database).contains("ros2 bag convert"),
        "{}",
        refused(&database)
    );
    assert!(matches!(
        recordings(&place.path("traces")),
        Err(ImportError::NoRecording { .. })
    ));
}

#[test]
fn issue_schemas_that_cannot_be_meant() {
    use prost::Message as _;
    let place = Place::new();
    let path = place.path("schema.mcap");
    let field = prost_types::FieldDescriptorProto {
        name: Some("tool".into()),
        number: Some(0),
        r#type: Some(11),
        type_name: Some(".r.Nothing".into()),
        ..Default::default()
    };
    let message = prost_types::DescriptorProto {
        name: Some("Call".into()),
        field: vec![field],
        ..Default::default()
    };
    let file = prost_types::FileDescriptorProto {
        name: Some("r.proto".into()),
        package: Some("r".into()),
        message_type: vec![message],
        ..Default::default()
    };
    let contradicting = prost_types::FileDescriptorSet { file: vec![file] }.encode_to_vec();
    // A message in itself, a list longer than its message, and a type that nothing defines.
    let itself = "Call other\n====\nMSG: r/Call\nCall other\n";
    #[rustfmt::skip]
    let cases: [(bags::Schema<'_>, &str, &str); 6] = [
        (("r.Call", "protobuf", &contradicting), "protobuf", "the schema of r.Call cannot be read"),
        (("r.Call", "protobuf", b""), "protobuf", "the schema does not define r.Call"),
        (("r/msg/Call", "ros2msg", itself.as_bytes()), "cdr", "messages in messages without end"),
        (
            ("r/msg/Call", "ros2msg", b"float64[99999999999] tool\n"),
            "cdr",
            "99999999999 elements in 4 bytes",
        ),
        (
            ("r/msg/Call", "ros2msg", b"Nothing tool\n"),
            "cdr",
            "the schema does not define r/Nothing",
        ),
        (
            ("r/msg/Call", "ros2idl", b"module r {};"),
            "cdr",
            "a schema in ros2idl; of CDR only ros2msg is read",
        ),
    ];
    for (schema, encoding, expected) in cases {
        bags::write_under(&path, schema, encoding, &[0, 1, 0, 0, 9, 9, 9, 9]);
        let error = import(&path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("1 of the messages on /call") && error.contains(expected),
            "{error}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn changed_bytes_never_panic(
        encoding in prop_oneof![Just(Encoding::Json), Just(Encoding::Protobuf), Just(Encoding::Cdr)],
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let place = Place::new();
        let path = place.path("changed.mcap");
        // Without compression and checksums every change reaches the messages.
        bags::write_with(&path, &without_images(), encoding, None);
        let mut bytes = fs::read(&path).unwrap();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        fs::write(&path, &bytes).unwrap();
        if let Ok(recording) = import(&path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN) {
            recording.episodes.iter().for_each(|imported| drop(healthy(&imported.trace)));
        }
    }

    #[test]
    fn changed_messages_never_panic(
        encoding in prop_oneof![Just(Encoding::Json), Just(Encoding::Protobuf), Just(Encoding::Cdr)],
        changes in prop::collection::vec((any::<prop::sample::Index>(), prop::collection::vec(any::<u8>(), 0..80)), 1..12),
    ) {
        let place = Place::new();
        let path = place.path("changed.mcap");
        let mut messages = without_images();
        messages.insert(6, jpeg(2_400, (64, 64), [1, 2, 3]));
        for (index, bytes) in changes {
            index.get_mut(&mut messages).instead = Some(bytes);
        }
        bags::write_with(&path, &messages, encoding, None);
        if let Ok(recording) = import(&path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN) {
            recording.episodes.iter().for_each(|imported| drop(healthy(&imported.trace)));
        }
    }
}
