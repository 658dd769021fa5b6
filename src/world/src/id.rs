//! Identifiers as newtypes over strings, so that an asset is never taken for an instance.

use std::{borrow::Borrow, fmt, sync::Arc};

use serde::{Deserialize, Serialize};

macro_rules! string_id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(from = "String", into = "String")]
        pub struct $name(Arc<str>);

        impl $name {
            /// The identifier as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }
        impl From<&str> for $name {
            fn from(text: &str) -> Self {
                Self(text.into())
            }
        }
        impl From<$name> for String {
            fn from(id: $name) -> Self {
                id.as_str().to_owned()
            }
        }
        impl From<String> for $name {
            fn from(text: String) -> Self {
                Self(text.into())
            }
        }
        impl Borrow<str> for $name {
            fn borrow(&self) -> &str {
                &self.0
            }
        }
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Debug::fmt(&self.0, f)
            }
        }
    };
}

string_id!(
    /// An asset: a kind of thing that may stand in several places at once.
    AssetId
);
string_id!(
    /// One thing in one task: `<asset>_on_<receptacle>_at_<task>` (docs/spec.md#world-graph).
    InstanceId
);
string_id!(
    /// A receptacle of a scene, e.g. `table_1`; [`FLOOR`] is the place of what fell.
    ReceptacleId
);

/// The place of an object that rests on no receptacle.
pub const FLOOR: &str = "floor";

impl InstanceId {
    /// Builds the key `<asset>_on_<receptacle>_at_<task>`.
    pub fn new(asset: &AssetId, receptacle: &ReceptacleId, task: &str) -> Self {
        format!("{asset}_on_{receptacle}_at_{task}").into()
    }

    /// The asset this is an instance of: the key up to `_on_`.
    pub fn asset(&self) -> AssetId {
        match self.0.split_once("_on_") {
            Some((asset, _)) => asset.into(),
            None => self.as_str().into(),
        }
    }
}
