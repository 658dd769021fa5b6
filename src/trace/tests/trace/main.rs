//! Traces from the outside: what is recorded is what is read, and nothing else is believed.

mod chain;
mod damage;
mod doctor;
mod flips;
mod layers;
mod logprobs;
mod recovery;
mod robot;
mod round_trip;
mod sample;
mod shards;
mod viewers;
