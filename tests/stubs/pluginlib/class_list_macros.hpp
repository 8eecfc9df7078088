// Instead of a plugin that a class loader finds: a function that makes one.
#pragma once
#include <memory>
#define PLUGINLIB_EXPORT_CLASS(Plugin, Base) \
  std::shared_ptr<Base> load_plugin() { return std::make_shared<Plugin>(); }
