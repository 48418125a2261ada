//! A seeded radar city.
