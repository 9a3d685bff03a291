"""Plans in three dimensions, in the browser (extra ``view``)."""

from trocar.view.suture import SutureView, show_plan

__all__ = ["SutureView", "show_plan"]
