//! Datasets of recorded episodes, and what the lint finds in them after each kind of damage.

mod damage;
mod export;
