//! What engines reuse from question to question.

use std::any::Any;

/// One thread's buffers of every engine it asked, each made when its engine is first asked. An engine
/// of another crate keeps its own here, too.
#[derive(Default)]
pub struct EngineWorkspace {
    buffers: Vec<Box<dyn Any + Send + Sync>>,
}

impl EngineWorkspace {
    /// The buffers of a type, as the last user left them.
    pub fn buffers<B: Default + Send + Sync + 'static>(&mut self) -> &mut B {
        let known = self.buffers.iter().position(|any| (**any).is::<B>());
        let index = known.unwrap_or_else(|| {
            self.buffers.push(Box::<B>::default());
            self.buffers.len() - 1
        });
        let Some(buffers) = self.buffers[index].downcast_mut() else {
            unreachable!("an entry is found by its type")
        };
        buffers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches buffers that are made anew for each question, and one type's that are given to another.
    #[test]
    fn each_type_finds_its_own_buffers_again() {
        let mut workspace = EngineWorkspace::default();
        workspace.buffers::<Vec<u8>>().push(7);
        workspace.buffers::<Vec<u32>>().push(9);
        assert_eq!(*workspace.buffers::<Vec<u8>>(), [7]);
        assert_eq!(*workspace.buffers::<Vec<u32>>(), [9]);
    }
}
