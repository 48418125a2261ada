//! Draws map tiles on request, and remembers.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use echofix_core::geo::TileId;
use moka::sync::Cache;

use super::plane::Plane;
use super::summary::{self, TileSummary};
use super::view_content::{SPOT_SHIFT, TILES_FROM, ViewContent};
use super::{Layer, Overview, Spot, View, palette};
use crate::http::error::Error;
use crate::locating::Expectations;
use crate::patience::Patience;
use crate::store::{MapStore, TileInfo};

/// Bytes of pictures to remember.
const PICTURES: u64 = 32 << 20;
/// Bytes of tile summaries to remember.
const SUMMARIES: u64 = 64 << 20;
/// The overview is made anew at most this often.
const OVERVIEW_EVERY: Duration = Duration::from_secs(1);

/// The answer to a request for a map tile.
pub struct Picture {
    /// The picture's entity tag.
    pub tag: String,
    /// The picture; absent when the one asked about is still right.
    pub png: Option<Bytes>,
}

/// Draws map tiles. Every call may block on the disk.
pub struct Artist {
    store: Arc<dyn MapStore>,
    expectations: Arc<Expectations>,
    pictures: Cache<(Layer, View), (String, Bytes)>,
    summaries: Cache<TileId, ((u64, u16), Arc<TileSummary>)>,
    overview: Mutex<Option<(Instant, Arc<Overview>)>>,
}

impl Artist {
    /// An artist who has drawn nothing yet.
    pub fn new(store: Arc<dyn MapStore>, expectations: Arc<Expectations>) -> Self {
        Self {
            store,
            expectations,
            pictures: Cache::builder()
                .max_capacity(PICTURES)
                .weigher(|_, (_, png): &(String, Bytes)| png.len() as u32)
                .build(),
            summaries: Cache::builder()
                .max_capacity(SUMMARIES)
                .weigher(|_, (_, summary): &((u64, u16), Arc<TileSummary>)| summary.weight() as u32)
                .build(),
            overview: Mutex::new(None),
        }
    }

    /// A view of a layer, unless `is_known` knows its tag.
    ///
    /// # Errors
    /// When the store refuses, or nobody waits for the picture any more.
    pub fn draw(
        &self,
        layer: Layer,
        view: View,
        is_known: impl Fn(&str) -> bool,
        patience: &Patience,
    ) -> Result<Picture, Error> {
        // Before all that is read: what is read of a later day is not remembered as of this one.
        let newest_day = self.store.totals().newest_day;
        let content = match view.z {
            z if z < layer.min_zoom() => ViewContent::Near(Vec::new()),
            z if z < TILES_FROM => ViewContent::Far(self.overview()?),
            _ => ViewContent::near(&*self.store, layer, &view)?,
        };
        let tag = content.tag(layer, &view, (self.store.lineage(), newest_day), self.expectations.judged());
        if is_known(&tag) {
            return Ok(Picture { tag, png: None });
        }
        if let Some((_, png)) = self.pictures.get(&(layer, view)).filter(|(cached, _)| *cached == tag) {
            return Ok(Picture { tag, png: Some(png) });
        }
        let spots = content
            .spots(layer, &view, &|plane, tile| self.fetch(layer, plane, tile, newest_day, patience))?;
        let png = Bytes::from(palette::paint(layer, view.side, &spots, newest_day)?);
        self.pictures.insert((layer, view), (tag.clone(), png.clone()));
        Ok(Picture { tag, png: Some(png) })
    }

    /// The whole map from far away, at most a second old or of the newest epoch.
    ///
    /// # Errors
    /// When the store refuses.
    pub fn overview(&self) -> Result<Arc<Overview>, Error> {
        let epoch = self.store.progress().borrow().epoch;
        // Held while it is made: requests at the same time wait for one instead of making many.
        let mut cached = lock(&self.overview);
        if let Some((made, overview)) = &*cached
            && (overview.epoch == epoch || made.elapsed() < OVERVIEW_EVERY)
        {
            return Ok(Arc::clone(overview));
        }
        let overview = Arc::new(Overview::of(&*self.store)?);
        *cached = Some((Instant::now(), Arc::clone(&overview)));
        Ok(overview)
    }

    /// Adds a tile to a plane: cell by cell to a fine one, as its summary to a coarse one; or spot by spot,
    /// where it is shown what can be expected of fixes.
    fn fetch(
        &self,
        layer: Layer,
        plane: &mut Plane,
        tile: &TileInfo,
        day: u16,
        patience: &Patience,
    ) -> Result<(), Error> {
        if patience.is_over() {
            return Err(Error::Gone);
        }
        if layer == Layer::Localizability {
            if let Some(expected) = self.expectations.tile(tile.id, patience)? {
                let spot = |expected| Spot::of_expected(expected, self.expectations.verdict(expected));
                let found = expected.spots().map(|(x, y, expected)| (x as u32, y as u32, spot(expected)));
                plane.add(tile.id, SPOT_SHIFT, found);
            }
        } else if plane.shift() >= summary::SHIFT {
            if let Some(summary) = self.summary(tile, day)? {
                plane.add(tile.id, summary::SHIFT, summary.blocks());
            }
        } else if let Some(stored) = self.store.tile(tile.id)? {
            plane.add(tile.id, 0, summary::cells(&stored.tile));
        }
        Ok(())
    }

    fn summary(&self, tile: &TileInfo, day: u16) -> Result<Option<Arc<TileSummary>>, Error> {
        let cached = self.summaries.get(&tile.id);
        if let Some((at, summary)) = cached
            && at == (tile.version, day)
        {
            return Ok(Some(summary));
        }
        let Some(stored) = self.store.tile(tile.id)? else { return Ok(None) };
        let summary = Arc::new(TileSummary::of(&stored.tile));
        self.summaries.insert(tile.id, ((stored.version, stored.day), Arc::clone(&summary)));
        Ok(Some(summary))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic while holding it leaves an overview that is whole, or none.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
