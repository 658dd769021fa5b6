//! What an agent says it has done (`History`, SPEC section 4), sentence by sentence, beside what the record says was done.
//!
//! Owns the reading of sentences as claims, the verdict on each, and the mending of a text. Never writes a History of its
//! own, and never judges what is neither shown nor refuted by the record.
