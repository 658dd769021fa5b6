//! Compiles the official messages of OTLP, without a system `protoc`, to Rust types that are read from and
//! written as protobuf and, with serde, OTLP/JSON.

use std::{env, error::Error, path::PathBuf};

/// The root; what it imports comes along.
const SCHEMA: &str = "opentelemetry/proto/collector/trace/v1/trace_service.proto";

/// Fields in which OTLP/JSON is not the JSON of serde, with the module of `src/json.rs` that reads and writes them.
const FIELDS: &[(&str, &str)] = &[
    ("trace.v1.Span.trace_id", "hex"),
    ("trace.v1.Span.span_id", "hex"),
    ("trace.v1.Span.parent_span_id", "hex"),
    ("trace.v1.Span.Link.trace_id", "hex"),
    ("trace.v1.Span.Link.span_id", "hex"),
    ("trace.v1.Span.start_time_unix_nano", "text_u64"),
    ("trace.v1.Span.end_time_unix_nano", "text_u64"),
    ("trace.v1.Span.Event.time_unix_nano", "text_u64"),
    ("trace.v1.Span.kind", "span_kind"),
    ("trace.v1.Status.code", "status_code"),
    (
        "collector.trace.v1.ExportTracePartialSuccess.rejected_spans",
        "text_i64",
    ),
    ("common.v1.AnyValue.value.int_value", "text_i64"),
    ("common.v1.AnyValue.value.double_value", "double"),
    ("common.v1.AnyValue.value.bytes_value", "base64_bytes"),
];

/// Fields that are left out where they are empty, as OTLP/JSON allows.
const OPTIONAL: &[&str] = &[
    "trace.v1.ResourceSpans.resource",
    "trace.v1.ResourceSpans.schema_url",
    "trace.v1.ScopeSpans.scope",
    "trace.v1.ScopeSpans.schema_url",
    "trace.v1.Span.trace_state",
    "trace.v1.Span.parent_span_id",
    "trace.v1.Span.flags",
    "trace.v1.Span.attributes",
    "trace.v1.Span.dropped_attributes_count",
    "trace.v1.Span.events",
    "trace.v1.Span.dropped_events_count",
    "trace.v1.Span.links",
    "trace.v1.Span.dropped_links_count",
    "trace.v1.Span.status",
    "trace.v1.Span.Event.attributes",
    "trace.v1.Span.Event.dropped_attributes_count",
    "trace.v1.Span.Link.attributes",
    "trace.v1.Span.Link.dropped_attributes_count",
    "trace.v1.Status.message",
    "resource.v1.Resource.dropped_attributes_count",
    "resource.v1.Resource.entity_refs",
    "common.v1.InstrumentationScope.version",
    "common.v1.InstrumentationScope.attributes",
    "common.v1.InstrumentationScope.dropped_attributes_count",
    "common.v1.KeyValue.key_strindex",
    "collector.trace.v1.ExportTraceServiceResponse.partial_success",
];

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../../schemas");
    println!(
        "cargo:rerun-if-changed={}",
        root.join("opentelemetry").display()
    );
    let descriptors = protox::Compiler::new([&root])?
        .include_imports(true)
        .open_files([SCHEMA])?
        .file_descriptor_set();
    let field = |path: &str| format!(".opentelemetry.proto.{path}");
    let mut config = prost_build::Config::new();
    config
        .include_file("otlp.rs")
        .message_attribute(".", "#[derive(serde::Serialize, serde::Deserialize)]")
        .message_attribute(".", "#[serde(rename_all = \"camelCase\", default)]")
        .enum_attribute(
            field("common.v1.AnyValue.value"),
            "#[derive(serde::Serialize, serde::Deserialize)] #[serde(rename_all = \"camelCase\")]",
        )
        // Without a dot before it the path does not name the variants as well.
        .field_attribute("AnyValue.value", "#[serde(flatten)]");
    for (path, module) in FIELDS {
        let attribute = format!("#[serde(with = \"crate::json::{module}\")]");
        config.field_attribute(field(path), attribute);
    }
    for path in OPTIONAL {
        config.field_attribute(
            field(path),
            "#[serde(skip_serializing_if = \"crate::json::is_default\")]",
        );
    }
    config.compile_fds(descriptors)?;
    Ok(())
}
