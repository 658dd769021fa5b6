//! The pages of `docs/reference` that are written from the binary: its commands and its REST
//! routes.

use std::{collections::BTreeMap, env, fmt::Write, fs, process::Command};

use serde_json::Value;

use crate::root;

/// How both pages begin.
const GENERATED: &str =
    "<!-- REEL_BLESS=1 cargo test --test guides reference: writes this page -->";

/// The help of every command by its name with all parents, such as `reel query`. Hidden commands
/// are not among them.
pub fn commands() -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut names = vec!["reel".to_owned()];
    while let Some(name) = names.pop() {
        let words: Vec<&str> = name.split(' ').skip(1).collect();
        let mut command = Command::new(env!("CARGO_BIN_EXE_reel"));
        for (variable, _) in env::vars_os() {
            if variable.to_string_lossy().starts_with("REEL_") {
                command.env_remove(variable);
            }
        }
        let output = command.args(&words).arg("--help").output().unwrap();
        let help = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success(), "{name} --help");
        let listed = help.split("\nCommands:\n").nth(1).unwrap_or_default();
        for line in listed
            .lines()
            .take_while(|line| !line.starts_with("Options:"))
        {
            // Two spaces, the name, and at least one space before what it is for.
            let child = line
                .strip_prefix("  ")
                .and_then(|line| line.split(' ').next());
            let child = child.filter(|it| it.starts_with(|c: char| c.is_ascii_lowercase()));
            names.extend(
                child
                    .filter(|it| *it != "help")
                    .map(|it| format!("{name} {it}")),
            );
        }
        found.insert(name, help);
    }
    found
}

#[test]
fn reference_of_the_command_line() {
    let commands = commands();
    let mut page = format!(
        "# Command line\n\n{GENERATED}\n\n`reel` has {} commands. `reel COMMAND --help` prints what \
         stands here.\n",
        commands.len() - 1
    );
    for (name, help) in commands {
        let help: Vec<&str> = help.trim_end().lines().map(str::trim_end).collect();
        write!(page, "\n## {name}\n\n```text\n{}\n```\n", help.join("\n")).unwrap();
    }
    compare("docs/reference/cli.md", &page);
}

#[test]
fn reference_of_the_rest_routes() {
    let document = serde_json::to_value(reel_server::openapi()).unwrap();
    let mut page = format!(
        "# REST\n\n{GENERATED}\n\nThe routes of `reel serve`. The server offers the same as OpenAPI \
         at `/api/openapi.json`. Where tokens are demanded, a request carries \
         `Authorization: Bearer TOKEN` ([security](../security.md)).\n"
    );
    for tag in array(&document["tags"]) {
        let name = text(&tag["name"]);
        write!(page, "\n## {name}\n\n{}\n", text(&tag["description"])).unwrap();
        for (path, methods) in object(&document["paths"]) {
            for (method, operation) in object(methods) {
                if array(&operation["tags"]).iter().any(|it| text(it) == name) {
                    write_operation(&mut page, &method.to_uppercase(), path, operation);
                }
            }
        }
    }
    page += "\n## Schemas\n";
    for (name, schema) in object(&document["components"]["schemas"]) {
        write!(page, "\n### {name}\n\n").unwrap();
        write_schema(&mut page, schema);
    }
    compare("docs/reference/rest.md", &page);
    // The types of the web pages come from this one: node dashboards/generate.mjs.
    let document = serde_json::to_string_pretty(&document).unwrap() + "\n";
    compare("schemas/openapi.json", &document);
}

fn write_operation(page: &mut String, method: &str, path: &str, operation: &Value) {
    write!(page, "\n### {method} {path}\n\n").unwrap();
    for part in ["summary", "description"] {
        if let Some(said) = operation[part].as_str() {
            write!(page, "{said}\n\n").unwrap();
        }
    }
    if let Some(role) = operation.pointer("/security/0/token/0") {
        write!(page, "Role of the token: `{}`.\n\n", text(role)).unwrap();
    }
    let parameters = array(&operation["parameters"]);
    if !parameters.is_empty() {
        page.push_str("| parameter | in | type | |\n|---|---|---|---|\n");
    }
    for parameter in parameters {
        let kind = kind(&parameter["schema"]);
        let required = if parameter["required"] == true {
            ""
        } else {
            ", optional"
        };
        let (name, place) = (text(&parameter["name"]), text(&parameter["in"]));
        row(
            page,
            &[
                &format!("`{name}`"),
                place,
                &format!("{kind}{required}"),
                text(&parameter["description"]),
            ],
        );
    }
    for (media, body) in object(&operation["requestBody"]["content"]) {
        write!(page, "\nBody: {}, `{media}`\n", kind(&body["schema"])).unwrap();
    }
    page.push_str("\n| status | body | |\n|---|---|---|\n");
    for (status, response) in object(&operation["responses"]) {
        let bodies = object(&response["content"]).into_iter();
        let bodies: Vec<String> = bodies
            .map(|(media, body)| match media.as_str() {
                "application/json" => kind(&body["schema"]),
                media => format!("`{media}`"),
            })
            .collect();
        row(
            page,
            &[status, &bodies.join(" or "), text(&response["description"])],
        );
    }
}

fn write_schema(page: &mut String, schema: &Value) {
    if let Some(said) = schema["description"].as_str() {
        write!(page, "{said}\n\n").unwrap();
    }
    let fields = object(&schema["properties"]);
    if fields.is_empty() {
        writeln!(page, "{}", kind(schema)).unwrap();
        return;
    }
    page.push_str("| field | type | |\n|---|---|---|\n");
    for (name, field) in fields {
        let is_required = array(&schema["required"]).iter().any(|it| text(it) == name);
        let optional = if is_required { "" } else { ", optional" };
        row(
            page,
            &[
                &format!("`{name}`"),
                &format!("{}{optional}", kind(field)),
                text(&field["description"]),
            ],
        );
    }
}

/// The type of a schema in words, with links to the schemas that it names.
fn kind(schema: &Value) -> String {
    if let Some(path) = schema["$ref"].as_str() {
        let name = path.rsplit('/').next().unwrap_or_default();
        return format!("[{name}](#{})", name.to_lowercase());
    }
    for any in ["oneOf", "anyOf", "allOf"] {
        if let Some(kinds) = schema[any].as_array() {
            let kinds: Vec<String> = kinds.iter().map(kind).filter(|it| it != "null").collect();
            return kinds.join(" or ");
        }
    }
    if let Some(values) = schema["enum"].as_array() {
        let values: Vec<String> = values.iter().map(|it| format!("`{}`", text(it))).collect();
        return values.join(", ");
    }
    let names = match &schema["type"] {
        Value::Array(names) => names.iter().map(text).filter(|it| *it != "null").collect(),
        name => vec![text(name)],
    };
    match names.as_slice() {
        ["array"] => format!("list of {}", kind(&schema["items"])),
        ["object"] if !object(&schema["properties"]).is_empty() => {
            let fields = object(&schema["properties"]);
            let fields: Vec<String> = fields
                .iter()
                .map(|(name, field)| format!("`{name}`: {}", kind(field)))
                .collect();
            format!("object with {}", fields.join(", "))
        }
        [""] | [] => "any".to_owned(),
        names => names.join(" or "),
    }
}

/// Writes a row of a table.
fn row(page: &mut String, cells: &[&str]) {
    let cells: Vec<String> = cells
        .iter()
        .map(|it| {
            it.split_whitespace()
                .collect::<Vec<_>>()
                .join(" ")
                .replace('|', "\\|")
        })
        .collect();
    writeln!(page, "| {} |", cells.join(" | ")).unwrap();
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// The members of an object, in the order of their names.
fn object(value: &Value) -> BTreeMap<&String, &Value> {
    value.as_object().into_iter().flatten().collect()
}

/// A generated page equals what is in the repository. `REEL_BLESS=1` writes it.
fn compare(path: &str, page: &str) {
    let file = root().join(path);
    if env::var_os("REEL_BLESS").is_some() {
        fs::write(&file, page).unwrap();
    }
    let written = fs::read_to_string(&file).unwrap_or_default();
    assert!(
        written == page,
        "{path} is stale: run REEL_BLESS=1 cargo test --test guides reference"
    );
}
