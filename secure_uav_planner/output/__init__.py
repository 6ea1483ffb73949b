"""Views and files of plans: picture, page, table, exports, and autopilots' frames."""
