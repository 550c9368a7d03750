-- A stand-in for those of ArduPilot's documented scripting functions that decklander_disarm.lua uses.
return function(millis, armed, disarm, mode, accel, throttle, get, add_table, add_param, receive, send)
   _G.millis = function() return { tofloat = function() return millis() end } end
   _G.arming = { is_armed = function() return armed() end, disarm = function() return disarm() end }
   _G.vehicle = { get_mode = function() return mode() end }
   _G.ahrs = { get_accel = function() return { z = function() return accel() end } end }
   _G.motors = { get_throttle = function() return throttle() end }
   _G.param = { get = function(_, n) return get(n) end,
  
   add_table = function(_, k, p, n) return add_table(k, p) end,
  
   add_param = function(_, k, i, n, v) return add_param(k, n, v) end }
   _G.mavlink = { init = function() end, register_rx_msgid = function(_, id) return id == 0 end,
  
   receive_chan = function() return receive() end }
   _G.gcs = { send_text = function(_, s, t) send(t) end } end
