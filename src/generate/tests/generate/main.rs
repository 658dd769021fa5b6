//! Scenes and objects: what comes along, what is made, and what the check finds.

mod mint;
