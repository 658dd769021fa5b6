//! Conversations in the formats of trainers: which columns hold turns, answers and images, as
//! expressions that give numbers.
//!
//! The keys are those of docs/spec.md#dataset-formats. What a row means to its trainer is the
//! linter's to say; here it is only counted.

use polars::prelude::{DataType, Expr, col, element, lit, when};

use crate::{Column, Table};

/// Names of the role that a model is trained to speak in.
const ANSWER_ROLES: [&str; 4] = ["assistant", "gpt", "function_call", "tool_call"];

/// What a set of conversations has for each row.
pub(crate) struct Conversation {
    /// The columns with the turns, for people.
    pub(crate) columns: String,
    /// Turns of the row.
    pub(crate) turns: Expr,
    /// Characters of each answer of the row, a list.
    pub(crate) answers: Option<Expr>,
    /// Images of the row.
    pub(crate) images: Option<Expr>,
    /// What the numbers leave out.
    pub(crate) note: Option<String>,
}

/// The conversation that the columns of a table hold, or `None` if they hold none.
pub(crate) fn recognise(table: &Table) -> Option<Conversation> {
    let column = |name: &str| table.columns().iter().find(|column| column.name == name);
    let images = ["images", "image"].iter().find_map(|name| {
        let column = column(name)?;
        match column.data_type {
            DataType::List(_) => Some(col(*name).list().len()),
            DataType::Null => None,
            _ => Some(col(*name).is_not_null()),
        }
    });
    let images = images.map(|images| images.cast(DataType::Float64));
    for name in ["messages", "conversations"] {
        let Some(turns) = column(name).and_then(Turns::of) else {
            continue;
        };
        let path = format!("{name}[].{}", turns.content);
        return Some(Conversation {
            columns: name.to_owned(),
            turns: turns.count(),
            answers: Some(turns.answers(true)),
            images,
            note: mixed(table, &path),
        });
    }
    let (prompt, completion) = (column("prompt")?, column("completion")?);
    let side = |column: &Column| match column.data_type {
        DataType::String => Some((
            col(column.name.as_str())
                .is_not_null()
                .cast(DataType::Float64),
            None,
        )),
        _ => Turns::of(column).map(|turns| (turns.count(), Some(turns))),
    };
    let ((asked, _), (answered, turns)) = (side(prompt)?, side(completion)?);
    let answers = match turns {
        Some(turns) => turns.answers(false),
        None => col("completion")
            .str()
            .len_chars()
            .cast(DataType::Float64)
            .reshape_to_list(),
    };
    Some(Conversation {
        columns: "prompt, completion".to_owned(),
        turns: asked.fill_null(0.0) + answered.fill_null(0.0),
        answers: Some(answers),
        images,
        note: mixed(table, "completion[].content"),
    })
}

/// Why lengths are those of JSON texts.
fn mixed(table: &Table, path: &str) -> Option<String> {
    let mixed = table.mixed().iter().find(|mixed| mixed.path == path)?;
    Some(format!(
        "'{}' holds {}: answers that are lists of parts are measured as JSON texts",
        mixed.path, mixed.kinds
    ))
}

trait Reshape {
    fn reshape_to_list(self) -> Expr;
}

impl Reshape for Expr {
    /// Each value as a list of one.
    fn reshape_to_list(self) -> Expr {
        polars::prelude::concat_list([self.clone()]).unwrap_or(self)
    }
}

/// A column of turns.
struct Turns {
    column: String,
    role: &'static str,
    content: &'static str,
    content_type: DataType,
}

impl Turns {
    /// The turns of a column, if it is a list of objects with a role and a content.
    fn of(column: &Column) -> Option<Self> {
        let DataType::List(item) = &column.data_type else {
            return None;
        };
        let DataType::Struct(fields) = &**item else {
            return None;
        };
        let field = |name: &str| fields.iter().find(|field| field.name == name);
        [("role", "content"), ("from", "value")]
            .into_iter()
            .find_map(|(role, content)| {
                (field(role)?.dtype == DataType::String).then_some(())?;
                Some(Self {
                    column: column.name.clone(),
                    role,
                    content,
                    content_type: field(content)?.dtype.clone(),
                })
            })
    }

    fn count(&self) -> Expr {
        col(self.column.as_str())
            .list()
            .len()
            .cast(DataType::Float64)
    }

    /// The lengths of the answers of a row in characters; of the turns in all roles if not `by_role`.
    fn answers(&self, by_role: bool) -> Expr {
        let turn = || element().struct_();
        let content = turn().field_by_name(self.content);
        let length = match &self.content_type {
            DataType::List(part) => match &**part {
                DataType::Struct(fields) if fields.iter().any(|field| field.name == "text") => {
                    content
                        .list()
                        .eval(element().struct_().field_by_name("text").str().len_chars())
                        .list()
                        .sum()
                }
                _ => content.list().len(),
            },
            DataType::String => content.str().len_chars(),
            _ => content.is_not_null().cast(DataType::UInt32) * lit(0_u32),
        };
        let length = length.cast(DataType::Float64);
        let length = if by_role {
            let role = turn().field_by_name(self.role);
            let answers = ANSWER_ROLES
                .iter()
                .map(|name| role.clone().eq(lit(*name)))
                .reduce(Expr::or)
                .unwrap_or(lit(true));
            when(answers)
                .then(length)
                .otherwise(lit(polars::prelude::NULL))
        } else {
            length
        };
        col(self.column.as_str()).list().eval(length)
    }
}
